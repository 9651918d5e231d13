"""Several scans in one frame, by the measured poses of their cameras.

Poses may be refined (extra ``sensors``): generalised ICP [Segal, Haehnel, Thrun 2009,
by `small_gicp`] registers one scan after the other to those already placed, the one
with the largest overlap first. Its result is weighted against the measured pose:

    δ = (H/σ² + Λ)⁻¹ (H/σ²) δ_gicp,   H = Σ J Jᵀ,   J = (p × n, n)

with δ the rotation and translation about the camera, Λ the information of the measured
pose, H that of the point-to-plane pairs and σ their residual. Refused are shapes that
leave a direction undetermined (a plane, a cylinder), results far from the measured
pose, and scans that do not overlap.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError, InputError, counted
from ttus_opt.core.optional import load
from ttus_opt.probe.pose import PoseLike, QuaternionOrder, from_quaternions
from ttus_opt.probe.recording_faults import checked
from ttus_opt.probe.rigid_motion import (
    homogeneous,
    inverse,
    motion_of,
    moved,
    rigid_motion,
    six_of,
)
from ttus_opt.sensors.depth import DepthCloud, DepthImage
from ttus_opt.sensors.depth_bag import Frame
from ttus_opt.sensors.depth_noise import NoiseModel
from ttus_opt.sensors.stream_files import raw_stream
from ttus_opt.sensors.stream_format import Wanted

#: Cell size to which scans are downsampled [m]
CELL = 0.005

#: Largest distance of a pair of points [m]
LARGEST_GAP = 0.02

#: Least fraction of a scan's points, and least number, that overlap the others
LEAST_OVERLAP, LEAST_PAIRS = 0.1, 200

#: Largest condition number of the pairs' information [–]: about 130 for a torso on a
#: bed; above 600 for a plane, a cylinder or an ellipsoid, with 3 mm of noise
LARGEST_CONDITION = 300.0

#: A result more standard deviations from the measured pose than this is refused
LEAVES = 4.0

#: Neighbours from which a normal is estimated
NEIGHBOURS = 40

#: Cameras within 60° of their mean direction, as the body sees them, saw one side [–]
ONE_SIDE = 0.5


@dataclass(frozen=True)
class PoseUncertainty:
    """Uncertainty of the measured camera poses.

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
                "a pose's standard deviations must be between 0 and 0.2 m and "
                f"between 0 and 0.5 rad, got {self.shift:g} and {self.turn:g}: "
                "another unit?"
            )


@dataclass(frozen=True)
class Refinement:
    """Result of refining the pose of one scan.

    Attributes:
        scan: Index of the scan.
        shift: Distance by which the camera was moved [m].
        turn: Angle by which it was turned [rad].
        overlap: Fraction of the scan's points near the others [–].
        residual_before: Root-mean-square distance to the others' planes at the measured
            pose [m].
        residual: The same at the refined pose [m].
        condition: Condition number of the pairs' information [–].
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
        poses: Camera to the common frame, refined or as measured, (n, 4, 4) [–, m].
        refinements: One per scan except the first; empty without refinement.
        frames: Which image of a recording each scan is; None for one alone.
    """

    cloud: DepthCloud
    poses: Array
    refinements: tuple[Refinement, ...]
    frames: tuple[Frame | None, ...] = ()

    @property
    def seen_from(self) -> Array | None:
        """Where the scan was seen from, shape (3,) [m]; None if from several sides."""
        places = self.poses[:, :3, 3]
        towards = places - np.median(self.cloud.points, axis=0)
        towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
        middle = towards.mean(axis=0)
        if (towards @ middle).min() < ONE_SIDE * np.linalg.norm(middle):
            return None
        return np.asarray(places.mean(axis=0))


def read_camera_poses(
    path: str | os.PathLike[str], n: int, *, order: QuaternionOrder = "wxyz"
) -> Array:
    """Poses of cameras, one per image in order, shape (n, 4, 4) [–, m].

    Args:
        path: A recording of any format (`ttus_opt.sensors.stream_files`), such as a
            table ``t,px,py,pz,qw,qx,qy,qz``: camera to scan [s, m].
        n: Number of images.
        order: Actual order of the four columns named ``qw,qx,qy,qz``.

    Raises:
        FileError: Missing, damaged, or another number of poses.
    """
    read = checked(raw_stream(path, Wanted(kind="poses")))
    found = len(read.time)
    if found != n:
        raise FileError(
            f"{os.fspath(path)} has {counted(found, 'pose')} for "
            f"{counted(n, 'image')}: write one line for each image, in their order"
        )
    assert read.quaternion is not None and read.position is not None
    return homogeneous(from_quaternions(read.quaternion, order), read.position)


def stitch(
    images: Sequence[DepthImage],
    poses: Sequence[PoseLike] | Array,
    *,
    noise: NoiseModel | None = None,
    refine: PoseUncertainty | None = None,
) -> Stitched:
    """Merge scans into one frame.

    Args:
        images: One or more.
        poses: Poses of their cameras, camera to the common frame, (4, 4) each [–, m].
        noise: Noise model of the cameras.
        refine: Uncertainty of the poses, to refine them; None to take them as they are.

    Raises:
        InputError: Another number of poses, an image without a surface, or a
            refinement that is refused; the message names the scan and the reason.
        MissingPackageError: Refinement without small_gicp installed.
    """
    if len(images) == 0 or len(images) != len(poses):
        raise InputError(
            f"{len(images)} images have {len(poses)} poses: give one pose for each"
        )
    if refine is not None and len(images) == 1:
        raise InputError("refining needs more than one scan: leave refine out")
    motions = np.stack([rigid_motion(pose) for pose in poses])
    clouds = [image.to_cloud(noise=noise) for image in images]
    refinements: tuple[Refinement, ...] = ()
    if refine is not None:
        motions, refinements = _refined([c.points for c in clouds], motions, refine)
    points = [moved(c.points, m) for c, m in zip(clouds, motions, strict=True)]
    deviations = [c.std for c in clouds if c.std is not None]
    cloud = DepthCloud(
        np.concatenate(points),
        np.concatenate(deviations) if deviations else None,
        tuple(c.dropped[0] for c in clouds),
    )
    return Stitched(cloud, motions, refinements, tuple(i.frame for i in images))


@dataclass(frozen=True)
class _Surfels:
    """A downsampled cloud with normals, and small_gicp's form of it."""

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
    clouds: list[Array], poses: Array, uncertainty: PoseUncertainty
) -> tuple[Array, tuple[Refinement, ...]]:
    """Poses refined so that each scan lies on those before; the first is kept."""
    poses = poses.copy()
    thinned = [_Surfels.of(cloud) for cloud in clouds]
    placed = [0]
    found = []
    while len(placed) < len(clouds):
        there = np.concatenate([moved(thinned[k].points, poses[k]) for k in placed])
        near = cKDTree(there)
        left = [k for k in range(len(clouds)) if k not in placed]
        shares = [_overlap(near, moved(thinned[k].points, poses[k])) for k in left]
        share, k = max(zip(shares, left, strict=True))
        poses[k], refinement = _one_refined(
            k, share, thinned[k], _Surfels.of(there), poses[k], uncertainty
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
    uncertainty: PoseUncertainty,
) -> tuple[Array, Refinement]:
    """The refined pose of scan k, and how it was refined."""
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
    registered = np.asarray(result.T_target_source)
    if not (result.converged and np.isfinite(registered).all()):
        raise InputError(f"{scan} could not be refined: leave refine out")
    after = _held(scan, source, target, registered)
    step = six_of(inverse(measured) @ registered)
    prior = np.repeat([1.0 / uncertainty.turn**2, 1.0 / uncertainty.shift**2], 3)
    information = after.information / after.residual**2
    fused = np.linalg.solve(information + np.diag(prior), information @ step)
    off = float(np.sqrt(prior * step**2).max())
    if off > LEAVES:
        shift, turn = (float(np.linalg.norm(v)) for v in (step[3:], step[:3]))
        raise InputError(
            f"{scan} would be moved by {1e3 * shift:.1f} mm and "
            f"{np.rad2deg(turn):.2f}°, {off:.1f} deviations of its measured pose, at "
            f"most {LEAVES:g} are accepted: check the pose, or state a larger "
            "deviation"
        )
    pose = measured @ motion_of(fused)
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
    """Points of a scan and the nearest planes of the others.

    Attributes:
        points: Camera axes, shape (n, 3) [m].
        normals: Normals of the planes, camera axes, shape (n, 3) [–].
        distance: Distances from points to planes, shape (n,) [m].
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
        """H about the camera: rotation, then translation, shape (6, 6)."""
        rows = np.hstack([np.cross(self.points, self.normals), self.normals])
        return np.asarray(rows.T @ rows)

    def condition(self) -> float:
        """Condition number of H about the centroid, rotations scaled by the radius."""
        centred = self.points - self.points.mean(axis=0)
        size = np.sqrt((centred**2).sum(axis=1).mean())
        rows = np.hstack([np.cross(centred, self.normals) / size, self.normals])
        values = np.linalg.eigvalsh(rows.T @ rows)
        return float(values[-1] / max(values[0], 1e-12 * values[-1]))


def _held(scan: str, source: _Surfels, target: _Surfels, pose: Array) -> _Pairs:
    """The pairs of a scan at a pose."""
    pairs = _pairs(source, target, pose)
    condition = pairs.condition()
    if condition > LARGEST_CONDITION:
        raise InputError(
            f"{scan} slides on the others ({condition:.0f} to 1 between the best and "
            f"the worst held direction, up to {LARGEST_CONDITION:.0f} is accepted): "
            "their common part is flat or round: show more, or leave refine out"
        )
    return pairs


def _pairs(source: _Surfels, target: _Surfels, pose: Array) -> _Pairs:
    """Each point of a scan with the nearest plane of the others."""
    placed = moved(source.points, pose)
    gap, index = cKDTree(target.points).query(placed, distance_upper_bound=LARGEST_GAP)
    near = np.isfinite(gap)
    if near.sum() < LEAST_PAIRS:
        raise InputError("refined scans no longer overlap: leave refine out")
    plane = np.asarray(index)[near]
    normals = target.normals[plane]
    away = placed[near] - target.points[plane]
    distance = (away * normals).sum(axis=1)
    return _Pairs(source.points[near], normals @ pose[:3, :3], distance)
