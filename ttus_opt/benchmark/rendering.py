"""How long a haptic frame takes, against straightforward numpy in the same run.

Wall time per frame gives the percentiles that a haptic loop sees, other programs on
the machine included; processor time per frame, least of several passes, is the frame's
own.
"""

from __future__ import annotations

import os
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.benchmark.plain_frame import LoopFrame, numpy_frame
from ttus_opt.errors import InputError
from ttus_opt.haptic.blend import BlendLaw
from ttus_opt.haptic.renderer import Renderer
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.voxmap.field import PotentialField

Frame = Callable[[Array, Array], object]

#: Between paced frames [s]
PAUSE = 1e-3


@dataclass(frozen=True)
class FrameTimes:
    """Times of one way to render, over all poses and passes.

    Attributes:
        median: Wall time [s].
        percentile_99: Wall time [s].
        percentile_99_9: Wall time [s].
        longest: Wall time [s].
        processor: Median over poses of the least processor time in any pass [s].
        processor_99_9: 99.9 % of all processor times: what is not the scheduler's [s].
    """

    median: float
    percentile_99: float
    percentile_99_9: float
    longest: float
    processor: float
    processor_99_9: float


@dataclass(frozen=True)
class RenderingFigures:
    """What one sampling costs.

    Attributes:
        sampling: ``voxel-mean`` or ``trilinear``.
        n_points: Points of the shell [–].
        contact_points: Median over the poses [–].
        frames: Frames timed for the renderer [–].
        numpy: Whole-array numpy.
        loop: One compiled loop over all points.
        renderer: `Renderer.render`.
        blending: `Renderer.render` while a swap of fields is under way.
        into: `Renderer.render_into`.
        paced: The same with a pause between frames, as a device calls it: caches have
            cooled and the thread must be woken.
        bytes_per_frame: Memory `render_into` still holds after a frame, on average
            over many [B].
        largest_difference: Of force between renderer and numpy [N].
        load: Programs running on the machine at the start, one minute's mean [–].
    """

    sampling: str
    n_points: int
    contact_points: float
    frames: int
    numpy: FrameTimes
    loop: FrameTimes
    renderer: FrameTimes
    blending: FrameTimes
    into: FrameTimes
    paced: FrameTimes
    bytes_per_frame: float
    largest_difference: float
    load: float


def time_rendering(
    field: PotentialField,
    shell: PointShell,
    rotation: Array,
    position: Array,
    *,
    passes: int = 50,
) -> RenderingFigures:
    """Time the renderer and its references over given poses.

    Args:
        field: The field.
        shell: The probe.
        rotation: Probe to patient, shape (T, 3, 3) [–].
        position: Of the probe frame's origin, shape (T, 3) [m].
        passes: Times each pose is rendered; numpy and paced frames a tenth of it.

    Returns:
        The figures.

    Raises:
        InputError: No poses, none in contact, or no passes.
    """
    if len(position) == 0 or passes < 1:
        raise InputError(
            f"timing needs poses and at least one pass, got {len(position)}, {passes}"
        )
    load = os.getloadavg()[0]
    poses = [
        (np.array(R), np.array(at)) for R, at in zip(rotation, position, strict=True)
    ]
    renderer, out = Renderer(field, shell), np.zeros(6)
    wrenches = [renderer.render(*pose) for pose in poses]
    difference = max(
        np.abs(numpy_frame(field, shell, *pose)[:3] - wrench.force).max()
        for pose, wrench in zip(poses, wrenches, strict=True)
    )
    touching = [
        pose
        for pose, wrench in zip(poses, wrenches, strict=True)
        if wrench.contact_points
    ]
    if not touching:
        raise InputError("no pose touches the patient: give poses in contact")

    def into(R: Array, at: Array) -> None:
        renderer.render_into(R, at, out)

    few = max(passes // 10, 1)
    return RenderingFigures(
        field.sampling,
        len(shell),
        float(np.median([wrench.contact_points for wrench in wrenches])),
        passes * len(poses),
        frame_times(lambda R, at: numpy_frame(field, shell, R, at), poses, few),
        frame_times(LoopFrame(field, shell), poses, passes),
        frame_times(renderer.render, poses, passes),
        frame_times(_blending(field, shell, touching).render, touching, passes),
        frame_times(into, poses, passes),
        frame_times(into, poses, few, pause=PAUSE),
        bytes_per_frame(renderer, poses),
        float(difference),
        load,
    )


def _blending(
    field: PotentialField, shell: PointShell, poses: list[tuple[Array, Array]]
) -> Renderer:
    """A renderer amid a swap too slow to end."""
    renderer = Renderer(field, shell, blend=BlendLaw(force_rate=1e-9))
    renderer.render(*poses[0])
    renderer.update(PotentialField(field.voxmap, 0.5 * field.values, field.sampling))
    return renderer


def frame_times(
    frame: Frame,
    poses: list[tuple[Array, Array]],
    passes: int,
    *,
    pause: float = 0.0,
) -> FrameTimes:
    """Time a way to render, pose by pose.

    Args:
        frame: Called with rotation and position.
        poses: What it is called with.
        passes: How many times over.
        pause: Slept before every frame, not timed [s].

    Returns:
        The times.
    """
    frame(*poses[0])  # compiles
    wall, own = np.empty((passes, len(poses))), np.empty((passes, len(poses)))
    for n in range(passes):
        for k, pose in enumerate(poses):
            if pause:
                time.sleep(pause)
            begin, before = time.thread_time_ns(), time.perf_counter_ns()
            frame(*pose)
            wall[n, k] = time.perf_counter_ns() - before
            own[n, k] = time.thread_time_ns() - begin
    wall *= 1e-9
    return FrameTimes(
        float(np.median(wall)),
        float(np.percentile(wall, 99.0)),
        float(np.percentile(wall, 99.9)),
        float(wall.max()),
        float(np.median(1e-9 * own.min(axis=0))),
        float(np.percentile(1e-9 * own, 99.9)),
    )


def bytes_per_frame(
    renderer: Renderer,
    poses: list[tuple[Array, Array]],
    *,
    frames: int = 1000,
    rounds: int = 5,
) -> float:
    """Memory that `Renderer.render_into` leaves behind, mean over frames [B].

    The least of several rounds: what other threads of the process take meanwhile is
    traced too, and is not the frame's.
    """
    out = np.zeros(6)
    renderer.render_into(*poses[0], out)
    left = []
    tracemalloc.start()
    try:
        for _ in range(rounds):
            before = tracemalloc.get_traced_memory()[0]
            for k in range(frames):
                renderer.render_into(*poses[k % len(poses)], out)
            left.append((tracemalloc.get_traced_memory()[0] - before) / frames)
    finally:
        tracemalloc.stop()
    return min(left)
