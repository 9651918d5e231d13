"""Several scans in one frame, by the measured poses of their cameras.

Poses may be refined (extra ``sensors``): generalised ICP [Segal, Haehnel, Thrun 2009,
by `small_gicp`] moves one scan after the other onto those already placed, the one that
overlaps them most first. What it finds is weighed against the measured pose:

    δ = (H/σ² + Λ)⁻¹ (H/σ²) δ_gicp,   H = Σ J Jᵀ,   J = (p × n, n)

with δ the turn and shift about the camera, Λ the measured pose's information, σ the
scatter of the points about each other's planes and H the information that the planes
hold. A shape that does not hold a scan in all directions (a plane, a cylinder), a
result that leaves the measured pose, and scans that do not overlap are refused.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ttus_opt.arrays import Array
from ttus_opt.errors import FileError, InputError
from ttus_opt.optional import load
from ttus_opt.probe.pose import PoseLike, QuaternionOrder, from_quaternions
from ttus_opt.probe.rigid_motion import inverse, rigid_motion
from ttus_opt.probe.trajectory_csv import read_trajectory_columns
from ttus_opt.sensors.depth import DepthCloud, DepthImage
from ttus_opt.sensors.depth_noise import NoiseModel

#: Points of a scan are averaged in cells of this size before they are compared [m]
CELL = 0.005

#: Points further apart than this are no pair [m]
LARGEST_GAP = 0.02

#: Least share of a scan's points, and least number, that overlap the others
LEAST_OVERLAP, LEAST_PAIRS = 0.1, 200

#: Largest ratio of what the shape holds best and worst [–]: about 130 for a torso on a
#: bed; above 600 for a plane, a cylinder or an ellipsoid, with 3 mm of noise
LARGEST_CONDITION = 300.0

#: A result further from the measured pose than this many of its deviations is refused
LEAVES = 4.0

#: Neighbours of a point that its normal is from
NEIGHBOURS = 40


@dataclass(frozen=True)
class PoseDoubt:
    """How well the poses of cameras were measured.

    Attributes:
        shift: Standard deviation along each axis [m].
        turn: Standard deviation about each axis of the camera [rad].
    """

    shift: float = 0.005
    turn: float = float(np.deg2rad(0.5))

    def __post_init__(self) -> None:
        """Validate the deviations.

        Raises:
            InputError: One is not positive, or in another unit.
        """
        if not (0.0 < self.shift < 0.2 and 0.0 < self.turn < 0.5):
            raise InputError(
                "a pose's deviations are between 0 and 0.2 m and between 0 and 0.5 "
                f"rad, got {self.shift:g} and {self.turn:g}: another unit?"
            )


@dataclass(frozen=True)
class Refinement:
    """What refining the pose of one scan found.

    Attributes:
        scan: Which, from 0.
        shift: How far the camera was moved [m].
        turn: By how much it was turned [rad].
        overlap: Share of the scan's points near the others [–].
        residual_before: Root mean square distance to the others' planes as measured
            [m].
        residual: The same, refined [m].
        condition: Ratio of what the shape holds best and worst [–].
    """

    scan: int
    shift: float
    turn: float
    overlap: float
    residual_before: float
    residual: float
    condition: float


@dataclass(frozen=True)
class Stitched:
    """Scans in one frame.

    Attributes:
        cloud: All points.
        poses: Camera to scan's frame, refined or as measured, shape (n, 4, 4) [–, m].
        refinements: One of every scan but that which the others are moved to; empty
            where poses are as measured.
    """

    cloud: DepthCloud
    poses: Array
    refinements: tuple[Refinement, ...]


def read_camera_poses(
    path: str | os.PathLike[str], n: int, *, order: QuaternionOrder = "wxyz"
) -> Array:
    """The poses of cameras, one for each image in its order.

    Args:
        path: A trajectory's CSV: ``t,px,py,pz,qw,qx,qy,qz``, camera to scan [s, m].
        n: Number of images.
        order: Order of the four columns named ``qw,qx,qy,qz`` as they stand.

    Returns:
        Shape (n, 4, 4) [–, m].

    Raises:
        FileError: Missing, damaged, or another number of poses.
    """
    read = read_trajectory_columns(path)
    found = len(read.time)
    if found != n:
        raise FileError(
            f"{os.fspath(path)} has {found} pose{'s' * (found != 1)}, there "
            f"{'is' if n == 1 else 'are'} {n} image{'s' * (n != 1)}: write one line "
            "for each image, in their order"
        )
    poses = np.tile(np.eye(4), (n, 1, 1))
    poses[:, :3, :3] = from_quaternions(read.quaternion, order)
    poses[:, :3, 3] = read.position
    return poses


def stitch(
    images: Sequence[DepthImage],
    poses: Sequence[PoseLike] | Array,
    *,
    noise: NoiseModel | None = None,
    refine: PoseDoubt | None = None,
) -> Stitched:
    """Put scans together.

    Args:
        images: One or more.
        poses: Of their cameras, camera to scan's frame, (4, 4) each [–, m].
        noise: The cameras' noise.
        refine: How well the poses were measured, to refine them; None to take them as
            they are.

    Returns:
        The scans in one frame.

    Raises:
        InputError: Another number of poses, an image without a surface, or a
            refinement that is refused; the message says which scan and why.
        MissingPackageError: To refine, small_gicp is not installed.
    """
    if len(images) == 0 or len(images) != len(poses):
        raise InputError(
            f"{len(images)} images have {len(poses)} poses: give one pose for each"
        )
    if refine is not None and len(images) == 1:
        raise InputError("one scan has no other to be refined to: leave refine out")
    motions = np.stack([rigid_motion(pose) for pose in poses])
    clouds = [image.to_cloud(noise=noise) for image in images]
    refinements: tuple[Refinement, ...] = ()
    if refine is not None:
        motions, refinements = _refined([c.points for c in clouds], motions, refine)
    points = [_moved(c.points, m) for c, m in zip(clouds, motions, strict=True)]
    deviations = [c.std for c in clouds if c.std is not None]
    cloud = DepthCloud(
        np.concatenate(points),
        np.concatenate(deviations) if deviations else None,
        tuple(c.dropped[0] for c in clouds),
    )
    return Stitched(cloud, motions, refinements)


def _moved(points: Array, motion: Array) -> Array:
    return np.asarray(points @ motion[:3, :3].T + motion[:3, 3])


@dataclass(frozen=True)
class _Surfels:
    """A thinned cloud with normals, and small_gicp's own form of it."""

    points: Array
    normals: Array
    cloud: Any
    tree: Any

    @classmethod
    def of(cls, points: Array) -> _Surfels:
        gicp = load("small_gicp", "sensors")
        cloud, tree = gicp.preprocess_points(points, CELL, NEIGHBOURS)
        own, normals = (np.array(v)[:, :3] for v in (cloud.points(), cloud.normals()))
        return cls(own, normals, cloud, tree)


def _refined(
    clouds: list[Array], poses: Array, doubt: PoseDoubt
) -> tuple[Array, tuple[Refinement, ...]]:
    """Poses moved so that each scan lies on those before, the first as measured."""
    poses = poses.copy()
    thinned = [_Surfels.of(cloud) for cloud in clouds]
    placed = [0]
    found = []
    while len(placed) < len(clouds):
        there = np.concatenate([_moved(thinned[k].points, poses[k]) for k in placed])
        near = cKDTree(there)
        left = [k for k in range(len(clouds)) if k not in placed]
        shares = [
            _overlap(near, _moved(thinned[k].points, poses[k])[:, :3]) for k in left
        ]
        share, k = max(zip(shares, left, strict=True))
        poses[k], refinement = _one_refined(
            k, share, thinned[k], _Surfels.of(there), poses[k], doubt
        )
        found.append(refinement)
        placed.append(k)
    return poses, tuple(sorted(found, key=lambda r: r.scan))


def _overlap(near: cKDTree, points: Array) -> float:
    gap, _ = near.query(points, distance_upper_bound=LARGEST_GAP)
    return float(np.isfinite(gap).mean())


def _one_refined(
    k: int,
    share: float,
    source: _Surfels,
    target: _Surfels,
    measured: Array,
    doubt: PoseDoubt,
) -> tuple[Array, Refinement]:
    """The pose of scan k, refined, and what was found.

    Raises:
        InputError: It is refused.
    """
    scan = f"scan {k + 1}"
    if share < LEAST_OVERLAP or share * len(source.points) < LEAST_PAIRS:
        raise InputError(
            f"{scan} overlaps the others by {100 * share:.0f} %, refining needs "
            f"{100 * LEAST_OVERLAP:.0f} %: check its pose, scan more of the same part, "
            "or leave refine out"
        )
    before = _held(scan, source, target, measured)
    gicp = load("small_gicp", "sensors")
    result = gicp.align(
        target.cloud,
        source.cloud,
        target.tree,
        measured,
        max_correspondence_distance=LARGEST_GAP,
        max_iterations=100,
        rotation_epsilon=1e-4,
        translation_epsilon=1e-5,
    )
    moved = np.asarray(result.T_target_source)
    if not (result.converged and np.isfinite(moved).all()):
        raise InputError(f"{scan} could not be refined: leave refine out")
    after = _held(scan, source, target, moved)
    change = inverse(measured) @ moved
    step = np.concatenate(
        [Rotation.from_matrix(change[:3, :3]).as_rotvec(), change[:3, 3]]
    )
    prior = np.repeat([1.0 / doubt.turn**2, 1.0 / doubt.shift**2], 3)
    information = after.information / after.residual**2
    fused = np.linalg.solve(information + np.diag(prior), information @ step)
    off = float(np.sqrt(prior * step**2).max())
    if off > LEAVES:
        shift, turn = (float(np.linalg.norm(v)) for v in (step[3:], step[:3]))
        raise InputError(
            f"{scan} would be moved by {1e3 * shift:.1f} mm and "
            f"{np.rad2deg(turn):.2f}°, {off:.1f} deviations of its measured pose, up "
            f"to {LEAVES:g} are accepted: check the pose, or state a larger deviation"
        )
    delta = np.eye(4)
    delta[:3, :3] = Rotation.from_rotvec(fused[:3]).as_matrix()
    delta[:3, 3] = fused[3:]
    pose = measured @ delta
    return pose, Refinement(
        k,
        float(np.linalg.norm(fused[3:])),
        float(np.linalg.norm(fused[:3])),
        share,
        before.residual,
        _pairs(source, target, pose).residual,
        after.condition(),
    )


@dataclass(frozen=True)
class _Pairs:
    """Points of a scan and the planes of the others they lie on.

    Attributes:
        points: Camera axes, shape (n, 3) [m].
        normals: Of the planes, camera axes, shape (n, 3) [–].
        distance: To the planes, shape (n,) [m].
    """

    points: Array
    normals: Array
    distance: Array

    @property
    def residual(self) -> float:
        """Root mean square distance to the planes [m]."""
        return float(np.sqrt(np.mean(self.distance**2)))

    @property
    def information(self) -> Array:
        """H about the camera: turn, then shift, shape (6, 6)."""
        rows = np.hstack([np.cross(self.points, self.normals), self.normals])
        return np.asarray(rows.T @ rows)

    def condition(self) -> float:
        """Of H about the points' middle, turns as lengths at their mean radius."""
        centred = self.points - self.points.mean(axis=0)
        size = np.sqrt((centred**2).sum(axis=1).mean())
        rows = np.hstack([np.cross(centred, self.normals) / size, self.normals])
        values = np.linalg.eigvalsh(rows.T @ rows)
        return float(values[-1] / max(values[0], 1e-12 * values[-1]))


def _held(scan: str, source: _Surfels, target: _Surfels, pose: Array) -> _Pairs:
    """The pairs of a scan at a pose.

    Raises:
        InputError: They do not hold it in all directions.
    """
    pairs = _pairs(source, target, pose)
    condition = pairs.condition()
    if condition > LARGEST_CONDITION:
        raise InputError(
            f"{scan} slides on the others ({condition:.0f} to 1 between the best and "
            f"the worst held direction, up to {LARGEST_CONDITION:.0f} is accepted): "
            "what they share is flat or round: show more, or leave refine out"
        )
    return pairs


def _pairs(source: _Surfels, target: _Surfels, pose: Array) -> _Pairs:
    """Each point of a scan with the nearest plane of the others.

    Raises:
        InputError: Hardly any has one.
    """
    placed = _moved(source.points, pose)
    gap, index = cKDTree(target.points).query(placed, distance_upper_bound=LARGEST_GAP)
    near = np.isfinite(gap)
    if near.sum() < LEAST_PAIRS:
        raise InputError("refined scans no longer overlap: leave refine out")
    plane = np.asarray(index)[near]
    normals = target.normals[plane]
    away = placed[near] - target.points[plane]
    distance = (away * normals).sum(axis=1)
    return _Pairs(source.points[near], normals @ pose[:3, :3], distance)
