"""Pairs of poses from two streams: one motion, seen by two devices at common instants.

Single poses that no motion explains are left out, the rest are joined at the frames of
the first stream, frames whose turns contradict the other stream are found (rotation
angles between two instants are the same in both), and pairs are spread over rotations.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.core.errors import InputError
from ttus_opt.probe.rigid_motion import homogeneous
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.sensors.streams import poses_at

#: A pose is a spike if it turned from half of so many poses on either side by so many
#: times the usual speed, and faster than this [rad/s]
NEIGHBOURS, SPIKE, BRISK = 4, 6.0, 2.0

#: Longest time between poses that is interpolated over [s]
LONGEST_GAP = 0.2

#: Offsets tried around that of the speeds, a coarse and a fine step [s]
WITHIN, COARSE, FINE = 0.3, 0.01, 0.002

#: Frames by which offsets are compared
FRAMES = 2000

#: Instants with which each frame's turns are compared
REFERENCES = 60

#: A frame disagrees if its turns differ by so many times the usual difference, and
#: more than this [rad]
DISAGREES, LEAST_DISAGREEMENT = 4.0, np.deg2rad(0.5)


def without_spikes(poses: Trajectory) -> Trajectory:
    """The poses without single ones that turned much faster than those around them.

    They would be heard in the angular speed, by which the clocks are aligned.
    """
    if len(poses) < 2 * NEIGHBOURS + 1:
        return poses
    turn = Rotation.from_matrix(poses.rotation)
    index = np.arange(len(poses))
    speeds = []
    for step in range(1, NEIGHBOURS + 1):
        for j in (index - step, index + step):
            j = np.where((j < 0) | (j >= len(poses)), 2 * index - j, j)
            span = np.abs(poses.time[j] - poses.time)
            angle = (turn[j] * turn.inv()).magnitude()
            speeds.append(angle / np.maximum(span, 1e-9))
    speed = np.median(speeds, axis=0)
    limit = max(BRISK, SPIKE * float(np.median(speed)))
    return poses.select(np.asarray(speed <= limit))


def aligned(
    seen: Trajectory, carried: Trajectory, offset: float
) -> tuple[Array, Array, Array]:
    """Times [s], A and B (n, 4, 4) at the frames of the first stream that both have.

    Raises:
        InputError: They do not overlap.
    """
    times, own, other = [], [], []
    for stretch in carried.recordings:
        if len(stretch) < 2:
            continue
        at = seen.time - offset
        inside = (at > stretch.time[0]) & (at < stretch.time[-1])
        if not inside.any():
            continue
        order = np.argsort(at[inside], kind="stable")
        rows = np.flatnonzero(inside)[order]
        rows = rows[np.r_[True, np.diff(at[rows]) > 0]]
        try:
            moved = poses_at(stretch, at[rows], largest_gap=LONGEST_GAP)
        except InputError:  # every common time lies in a gap
            continue
        rows = rows[np.isin(at[rows], moved.time)]
        times.append(seen.time[rows])
        own.append(homogeneous(seen.rotation[rows], seen.position[rows]))
        other.append(homogeneous(moved.rotation, moved.position))
    if not times:
        raise InputError(
            f"the streams do not overlap at an offset of {offset:.4g} s: check the "
            "clocks"
        )
    return np.concatenate(times), np.concatenate(own), np.concatenate(other)


def offset_by_angles(seen: Trajectory, carried: Trajectory, near: float) -> float:
    """Seconds to add to the second clock, by the angles between far instants.

    They are the same in both streams, as speeds are, but the noise of one pose is
    small against them; the median passes over outliers and gaps.

    Args:
        seen: Poses on the first clock.
        carried: Poses of the same body on the second clock.
        near: Offset by the speeds [s].
    """
    seen = seen.select(slice(None, None, 1 + len(seen) // FRAMES))
    carried = carried.select(np.unique(carried.time, return_index=True)[1])
    own = Rotation.from_matrix(seen.rotation)
    path = Slerp(carried.time, Rotation.from_matrix(carried.rotation))
    gap = np.diff(carried.time) > LONGEST_GAP
    gap |= np.diff(carried.segment) != 0

    def apart(offset: float) -> float:
        at = seen.time - offset
        after = np.searchsorted(carried.time, at)
        rows = np.flatnonzero((after > 0) & (after < len(carried)))
        rows = rows[~gap[after[rows] - 1]]
        if not len(rows):
            return np.inf
        pairs = np.roll(np.arange(len(rows)), len(rows) // 3)
        angles = [
            (turn * turn[pairs].inv()).magnitude()
            for turn in (own[rows], path(at[rows]))
        ]
        return float(np.median(np.abs(angles[0] - angles[1])))

    for reach, step in ((WITHIN, COARSE), (COARSE, FINE)):
        near = min(near + np.arange(-reach, reach + step / 2, step), key=apart)
    return float(near)


def agreeing(A: Array, B: Array, rng: np.random.Generator) -> Mask:
    """Mask of the frames that turn from most others by the same angle in both, (n,)."""
    chosen = rng.choice(len(A), min(REFERENCES, len(A)), replace=False)
    first, second = (
        [(turn * turn[j].inv()).magnitude() for j in chosen.tolist()]
        for turn in (Rotation.from_matrix(poses[:, :3, :3]) for poses in (A, B))
    )
    typical = np.median(np.abs(np.subtract(first, second)), axis=0)
    limit = max(DISAGREES * float(np.median(typical)), LEAST_DISAGREEMENT)
    return np.asarray(typical <= limit)


def far_apart(rotation: Array, most: int) -> IntArray:
    """Indices of rotations far from each other, most of them, in order."""
    if len(rotation) <= most:
        return np.arange(len(rotation))
    quaternion = Rotation.from_matrix(rotation).as_quat()
    chosen = [0]
    near = np.abs(quaternion @ quaternion[0])
    while len(chosen) < most:
        farthest = int(np.argmin(near))
        chosen.append(farthest)
        near = np.maximum(near, np.abs(quaternion @ quaternion[farthest]))
    return np.unique(chosen)
