"""Part ``rendering``: time of a haptic frame against whole-array numpy.

Percentiles are of wall time per frame, as in a haptic loop, including other programs on
the machine; the frame's own time is its processor time, the least of several passes.
`plain_samples` is a direct implementation of the sampling in
`ttus_opt.voxmap.sampling`, pose by pose, without sorting, culling or caching.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.machine import Progress
from ttus_opt.benchmark.parts.base import SHELL_POINTS, Column, Part
from ttus_opt.benchmark.row import Row, RunSpec, Settings
from ttus_opt.benchmark.summary import times
from ttus_opt.contact.contact_size import patch_factors, patches_of
from ttus_opt.contact.rows import REFERENCE_AREA, Sampling
from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.haptic.blend import BlendLaw
from ttus_opt.haptic.renderer import Renderer
from ttus_opt.probe.cylindrical import cylindrical
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.sampling import least_length
from ttus_opt.voxmap.voxmap import Voxmap, surface_layer


def numpy_frame(
    field: PotentialField, shell: PointShell, rotation: Array, position: Array
) -> Array:
    """Wrench of one pose in whole-array numpy.

    Args:
        field: The field.
        shell: The probe.
        rotation: Probe to patient, shape (3, 3) [–].
        position: Origin of the probe frame, shape (3,) [m].

    Returns:
        Force and torque, patient axes, shape (6,) [N, N·m].
    """
    points = shell.points @ rotation.T + position
    by_area = field.sampling != "voxel-mean"
    inside, voxels, shares = plain_samples(field.voxmap, points, field.sampling)
    weight = (shares * field.values.reshape(-1)[voxels]).sum(axis=1)
    if by_area:
        weight *= shell.areas[inside] / REFERENCE_AREA
    if least := least_length(field.sampling):
        pose = rotation[None], position[None]
        spread = patches_of(field.voxmap, shell, *pose).spread
        weight *= patch_factors(spread, least)[0]
    normals = shell.normals[inside] @ rotation.T
    moments = np.cross((shell.points[inside] - shell.reference) @ rotation.T, normals)
    return np.concatenate([weight @ normals, weight @ moments])


def plain_samples(
    voxmap: Voxmap, points: Array, sampling: str
) -> tuple[NDArray[np.bool_], NDArray[np.int64], Array]:
    """Voxels and weights that points sample (`ttus_opt.voxmap.sampling`).

    Args:
        voxmap: Grid and surface.
        points: Patient frame, shape (M, 3) [m].
        sampling: ``voxel-mean`` or ``trilinear``.

    Returns:
        Mask of points inside, shape (M,); their voxels and weights, shape (m, 1) or
        (m, 8), a weight of 0 for voxels that are not sampled.
    """
    grid = voxmap.grid
    r, theta, z = cylindrical(points)
    inside = (r <= grid.r_outer) & (z >= grid.z_min) & (z <= grid.z_max)
    inside[inside] = r[inside] < voxmap.surface.radius_at(theta[inside], z[inside])
    r, theta, z = r[inside], theta[inside], z[inside]
    depth = voxmap.surface.radius_at(theta, z) - r
    v, w = theta / grid.theta_step, (z - grid.z_min) / grid.z_step
    if sampling == "voxel-mean":
        return inside, *_voxel_means(voxmap, r, v, w, depth)
    j = np.minimum(v.astype(int), grid.shape[1] - 1)
    k = np.minimum(w.astype(int), grid.shape[2] - 2)
    voxels, shares = [], []
    for dj, dk in ((0, 0), (0, 1), (1, 0), (1, 1)):
        turn, height = (j + dj) % grid.shape[1], k + dk
        part = np.abs(1 - dj - (v - j)) * np.abs(1 - dk - (w - k))
        layers, along = _along_spoke(voxmap, turn, height, depth)
        for layer, share in zip(layers, along, strict=True):
            voxels.append(np.ravel_multi_index((layer, turn, height), grid.shape))
            shares.append(part * share)
    return inside, np.stack(voxels, axis=1), np.stack(shares, axis=1)


def _surface_of(
    voxmap: Voxmap, j: NDArray[np.int64], k: NDArray[np.int64]
) -> tuple[Array, NDArray[np.int64]]:
    """Radius of the surface on spokes [m], and the layer below the surface layer."""
    grid = voxmap.grid
    radius = voxmap.surface.radius_at(grid.theta[j], grid.z[k])
    return radius, surface_layer(grid, radius) - 1


def _along_spoke(
    voxmap: Voxmap, j: NDArray[np.int64], k: NDArray[np.int64], depth: Array
) -> tuple[tuple[NDArray[np.int64], NDArray[np.int64]], tuple[Array, Array]]:
    """Two layers on spokes (m,) and their weights, at depths (m,) [m]."""
    grid = voxmap.grid
    radius, last = _surface_of(voxmap, j, k)
    place = np.maximum(radius - depth, grid.r_inner)
    near = place >= grid.r[last]
    lower = np.minimum(((place - grid.r_inner) / grid.r_step).astype(int), last)
    upper = np.where(near, last, lower + 1)
    share = np.where(near, 0.0, (place - grid.r[lower]) / grid.r_step)
    to_surface = (radius - place) / (radius - grid.r[last])
    return (lower, upper), (np.where(near, to_surface, 1.0 - share), share)


def _voxel_means(
    voxmap: Voxmap, r: Array, v: Array, w: Array, depth: Array
) -> tuple[NDArray[np.int64], Array]:
    """Nearest voxels and weights in their means, shape (m, 1)."""
    grid = voxmap.grid
    u = np.maximum((r - grid.r_inner) / grid.r_step, 0.0)
    i, j, k = (np.floor(x + 0.5).astype(int) for x in (u, v, w))
    j %= grid.shape[1]
    radius, last = _surface_of(voxmap, j, k)
    face = grid.r[last] + grid.r_step / 2  # the inner face of the surface layer
    samples = (i <= last) & (radius - depth < face)
    voxel = np.ravel_multi_index((i, j, k), grid.shape)
    _, place = np.unique(voxel, return_inverse=True)
    counts = np.bincount(place, weights=samples)[place]
    return voxel[:, None], (samples / np.maximum(counts, 1.0))[:, None]


#: Repetitions of every pose
PASSES = 50

#: Pause between paced frames [s]
PAUSE = 1e-3

Pose = tuple[Array, Array]
Frame = Callable[[Array, Array], object]


def _microseconds(value: float) -> str:
    return f"{1e6 * value:,.0f}" if value >= 1e-4 else f"{1e6 * value:.3g}"


class RenderingPart(Part):
    """One run per case and sampling; the field is the Laplace field."""

    name = "rendering"
    title = "Time of a haptic frame"
    legend = (
        "Wall time per frame over the case's poses, percentiles as a haptic loop sees "
        "them, other programs included; *own* is the frame's processor time, least of "
        "several passes, median over the poses. *Paced* sleeps 1 ms between frames. "
        "It and numpy have a tenth of the others' frames. "
        "Ratios are of medians, to whole-array numpy in the same run."
    )
    columns = (
        Column("sampling", "sampling"),
        Column("way", "way"),
        Column("median [µs]", "median", _microseconds),
        Column("99 %", "percentile_99", _microseconds),
        Column("99.9 %", "percentile_99_9", _microseconds),
        Column("max", "longest", _microseconds),
        Column("own", "processor", _microseconds),
        Column("to numpy", "ratio_to_numpy", times),
    )

    def plan(self, cases: Sequence[CaseSpec], settings: Settings) -> list[RunSpec]:
        """Both samplings of every case."""
        return [
            RunSpec(
                self.name,
                replace(case, sampling=sampling, n_points=SHELL_POINTS),
                {"passes": PASSES, "sampling": sampling},
                settings.time_limit,
            )
            for case in cases
            for sampling in get_args(Sampling)
        ]

    def measure(self, spec: RunSpec, begin: Progress) -> list[Row]:
        """Time all ways over the case's poses."""
        begin("warm-up")
        with contextlib.suppress(InputError):  # its few poses may be off contact
            time_rendering(spec.scene_case.small().scene(), passes=1)
        begin("scene")
        scene = spec.scene_case.scene()
        begin("frames")
        return time_rendering(scene, passes=int(spec.options["passes"]))


def time_rendering(scene: Scene, *, passes: int = PASSES) -> list[Row]:
    """Time the renderer and numpy over a scene's poses, with its Laplace field.

    Args:
        scene: The scene.
        passes: Repetitions of each pose; a tenth for numpy and paced frames.

    Returns:
        A row per way to render: times as from `frame_times`, ``points`` of the shell
        and ``contact_points`` (median over the poses).

    Raises:
        InputError: No pose touches the patient.
    """
    values = scene.voxmap.grid.unflatten(scene.laplace.solve(scene.b))
    field = PotentialField(scene.voxmap, values, scene.sampling)
    poses = list(zip(scene.trajectory.rotation, scene.trajectory.position, strict=True))
    renderer, out = Renderer(field, scene.shell), np.zeros(6)

    def plain(R: Array, at: Array) -> Array:
        return numpy_frame(field, scene.shell, R, at)

    def into(R: Array, at: Array) -> None:
        renderer.render_into(R, at, out)

    contact = np.array([renderer.render(*pose).contact_points for pose in poses])
    if not contact.any():
        raise InputError("no pose touches the patient: give poses in contact")
    touching = [poses[t] for t in np.flatnonzero(contact)]
    blending = _blending(field, scene.shell, touching[0]).render
    few = max(passes // 10, 1)
    ways = {
        "numpy": frame_times(plain, poses, few),
        "render, back to back": frame_times(renderer.render, poses, passes),
        "render, amid a swap of fields": frame_times(blending, touching, passes),
        "render_into, back to back": frame_times(into, poses, passes),
        "render_into, paced": frame_times(into, poses, few, pause=PAUSE),
    }
    size = {"points": len(scene.shell), "contact_points": float(np.median(contact))}
    whole = ways["numpy"]["median"]
    return [
        {
            "sampling": field.sampling,
            "way": way,
            "ratio_to_numpy": taken["median"] / whole,
        }
        | taken
        | size
        for way, taken in ways.items()
    ]


def _blending(field: PotentialField, shell: PointShell, pose: Pose) -> Renderer:
    """A renderer during a swap of fields that does not end."""
    renderer = Renderer(field, shell, blend=BlendLaw(force_rate=1e-9))
    renderer.render(*pose)
    renderer.update(PotentialField(field.voxmap, 0.5 * field.values, field.sampling))
    return renderer


def frame_times(
    frame: Frame, poses: Sequence[Pose], passes: int, *, pause: float = 0.0
) -> Row:
    """Time a way to render, pose by pose.

    Args:
        frame: Called with rotation and position.
        poses: Rotations and positions.
        passes: Number of repetitions.
        pause: Untimed pause before every frame [s].

    Returns:
        Wall time: ``median``, percentiles, ``longest``; ``processor``: median over
        poses of the least processor time in any pass [s].
    """
    frame(*poses[0])  # compiles
    wall, processor = np.empty((passes, len(poses))), np.empty((passes, len(poses)))
    for n in range(passes):
        for k, pose in enumerate(poses):
            if pause:
                time.sleep(pause)
            begin, before = time.thread_time_ns(), time.perf_counter_ns()
            frame(*pose)
            wall[n, k] = 1e-9 * (time.perf_counter_ns() - before)
            processor[n, k] = 1e-9 * (time.thread_time_ns() - begin)
    return {
        "median": float(np.median(wall)),
        "percentile_99": float(np.percentile(wall, 99.0)),
        "percentile_99_9": float(np.percentile(wall, 99.9)),
        "longest": float(wall.max()),
        "processor": float(np.median(processor.min(axis=0))),
    }


PART = RenderingPart()
