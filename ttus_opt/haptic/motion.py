"""Estimate of the probe's twist from successive poses and their times.

Differences of poses 1 ms apart that jitter by 0.05 mm have 70 mm/s of noise, and drag
along them would chatter. The twist is therefore estimated in three steps:

- Two first-order low passes of the pose in series, each of time constant T, or of two
  frames if those are longer. Independent jitter is reduced to √(δt/4T) of itself.
- Play operator (backlash): a follower pose stays while the smoothed pose is within a
  radius ρ of it, and within the angle ρ/ℓ (ℓ the shell's rms radius); beyond, it is
  dragged along by the excess only. A probe at rest has no velocity at all, hence no
  direction that could flip. While it is not dragged, the follower is centred on the
  smoothed pose over `MEMORY`, which counts as no motion. ρ is the stated radius, or
  five standard deviations of the smoothed jitter if that is more. Jitter is measured
  from what successive poses deviate from uniform motion.
- First-order low pass of time constant T on the follower's velocity.

The low passes come first: play passes on the largest error of all frames, and at 1 kHz
there is one of four standard deviations every few seconds. The price is delay: 3T in
time, a travel of ρ before a start is noticed, and of 2ρ before a reversal. Over that
stretch drag still has its old direction and may do work on the probe: friction is
dissipative for the twist it is given (`ttus_opt.haptic.drag`), not for one that lags. A
caller who knows the twist should pass it. A constant velocity is estimated exactly; one
below ρ/`MEMORY` counts as rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ttus_opt.contact.rows import rotated
from ttus_opt.core.arguments import expect_positive
from ttus_opt.core.arrays import Array
from ttus_opt.core.compiled import compiled
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory

#: Length of a pose in a motion's state: position of the reference point, then rotation
#: row by row
POSE = 12

#: Indices in a motion's state: number of poses; time of the last one and of the step to
#: it; the last pose; the pose after one and after two low passes; the follower; the
#: last displacement and rotation vector; mean square jitter of a component of each;
#: filtered velocity of the reference point and angular velocity
KNOWN, TIME, STEP, SEEN = 0, 1, 2, 3
ONCE, TWICE, FOLLOWER = SEEN + POSE, SEEN + 2 * POSE, SEEN + 3 * POSE
WAY = FOLLOWER + POSE
JITTER = WAY + 6
VELOCITY = JITTER + 2
MOTION = VELOCITY + 6

#: Indices in `MotionFilter.kernel_numbers`
PLAY, ANGLE, SECONDS, GAP = 0, 1, 2, 3

#: Least play in standard deviations of a component of the smoothed jitter [–]
DEVIATIONS = 5.0

#: Least time constant in frames [–]
FRAMES = 2.0

#: Time constant of the measured jitter and of centring the follower [s]
MEMORY = 0.5


@dataclass(frozen=True)
class MotionFilter:
    """Parameters of the estimate of a twist from poses.

    Attributes:
        play: Least ρ, jitter within this radius counts as rest [m].
        seconds: T, time constant of each of the three low passes [s].
        gap: After a longer pause between poses the estimate restarts from rest [s].
    """

    play: float = 1e-4
    seconds: float = 0.01
    gap: float = 0.25

    def __post_init__(self) -> None:
        """Refuse a value that is not positive and finite."""
        for name in ("play", "seconds", "gap"):
            expect_positive(getattr(self, name), name)

    def kernel_numbers(self, length: float) -> Array:
        """Radius [m], angle [rad], time constant and gap [s], for ℓ [m]."""
        return np.array([self.play, self.play / length, self.seconds, self.gap])


@compiled(error_model="numpy", nogil=True)
def estimate_twist(
    motion: Array, R: Array, at: Array, time: float, reference: Array, numbers: Array,
    twist: Array,
) -> bool:  # fmt: skip
    """Update a motion with a pose and estimate the twist (compiled).

    Args:
        motion: State, shape (MOTION,), initially zeros; written.
        R: Rotation, probe to patient, shape (3, 3) [–].
        at: Position of the probe frame's origin, shape (3,) [m].
        time: Time of the pose [s]. The same time again leaves the motion unchanged.
        reference: Reference point of the shell, probe frame, shape (3,) [m].
        numbers: `MotionFilter.kernel_numbers`.
        twist: Out: velocity of the origin and angular velocity, patient axes, shape
            (6,) [m/s, rad/s]; zero for the first pose.

    Returns:
        False, with nothing written, if time decreases or is not finite.
    """
    x, y, z = rotated(R, reference[0], reference[1], reference[2])
    step = time - motion[TIME]
    if not math.isfinite(time) or (motion[KNOWN] != 0.0 and step < 0.0):
        return False
    if motion[KNOWN] == 0.0 or step > numbers[GAP]:
        for i in range(MOTION):
            motion[i] = 0.0
        for pose in (SEEN, ONCE, TWICE, FOLLOWER):
            set_pose(motion, pose, R, at[0] + x, at[1] + y, at[2] + z)
        motion[KNOWN] = 1.0
    elif step > 0.0:
        _see(motion, R, at[0] + x, at[1] + y, at[2] + z, step)
        _filter(motion, step, numbers)
        motion[KNOWN] += 1.0
    motion[TIME] = time
    wx, wy, wz = motion[VELOCITY + 3], motion[VELOCITY + 4], motion[VELOCITY + 5]
    twist[0] = motion[VELOCITY] - (wy * z - wz * y)
    twist[1] = motion[VELOCITY + 1] - (wz * x - wx * z)
    twist[2] = motion[VELOCITY + 2] - (wx * y - wy * x)
    twist[3], twist[4], twist[5] = wx, wy, wz
    return True


@compiled(error_model="numpy", nogil=True)
def _see(motion: Array, R: Array, x: float, y: float, z: float, step: float) -> None:
    """Store a pose and its deviation from uniform motion (compiled).

    With independent errors of standard deviation σ and c the ratio of the time steps,
    y_k − y_(k−1) − c (y_(k−1) − y_(k−2)) has variance (1 + (1 + c)² + c²) σ².
    """
    way = way_from(motion, SEEN, R, x, y, z)
    if motion[STEP] > 0.0:
        c = step / motion[STEP]
        spread = 3.0 * (1.0 + (1.0 + c) * (1.0 + c) + c * c)
        share = max(1.0 - math.exp(-step / MEMORY), 1.0 / (motion[KNOWN] - 1.0))
        for part in range(2):
            square = 0.0
            for i in range(3 * part, 3 * part + 3):
                off = way[i] - c * motion[WAY + i]
                square += off * off
            motion[JITTER + part] += share * (square / spread - motion[JITTER + part])
    for i in range(6):
        motion[WAY + i] = way[i]
    motion[STEP] = step
    set_pose(motion, SEEN, R, x, y, z)


@compiled(error_model="numpy", nogil=True)
def _filter(motion: Array, step: float, numbers: Array) -> None:
    """Smooth the pose, drag the follower along, smooth its velocity (compiled)."""
    seconds = max(numbers[SECONDS], FRAMES * step)
    share = 1.0 - math.exp(-step / seconds)
    _move(motion, ONCE, _between(motion, ONCE, SEEN), share, share)
    _move(motion, TWICE, _between(motion, TWICE, ONCE), share, share)
    way = _between(motion, FOLLOWER, TWICE)
    left = DEVIATIONS * math.sqrt(0.25 * step / seconds)
    play = max(numbers[PLAY], left * math.sqrt(motion[JITTER]))
    angle = max(numbers[ANGLE], left * math.sqrt(motion[JITTER + 1]))
    shift = math.sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
    turn = math.sqrt(way[3] * way[3] + way[4] * way[4] + way[5] * way[5])
    shifts = 1.0 - play / shift if shift > play else 0.0
    turns = 1.0 - angle / turn if turn > angle else 0.0
    centred = 1.0 - math.exp(-step / MEMORY)  # not a motion of the probe
    _move(motion, FOLLOWER, way, shifts or centred, turns or centred)
    for i in range(6):
        speed = (shifts if i < 3 else turns) * way[i] / step
        motion[VELOCITY + i] += share * (speed - motion[VELOCITY + i])


@compiled(inline="always")
def set_pose(state: Array, pose: int, R: Array, x: float, y: float, z: float) -> None:
    """Store a pose: position, then rotation (compiled)."""
    state[pose], state[pose + 1], state[pose + 2] = x, y, z
    for i in range(9):
        state[pose + 3 + i] = R[i // 3, i % 3]


#: Displacement [m] and rotation vector [rad]
Way = tuple[float, float, float, float, float, float]

#: No motion
STILL = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def ways_along(shell: PointShell, trajectory: Trajectory) -> Array:
    """Displacement of the shell's reference and rotation vector between frames.

    Shape (T - 1, 6) [m, rad].
    """
    R = trajectory.rotation
    places = trajectory.position + R @ np.asarray(shell.reference)
    turns = Rotation.from_matrix(R[1:] @ R[:-1].transpose(0, 2, 1)).as_rotvec()
    return np.concatenate([np.diff(places, axis=0), turns], axis=1)


@compiled(inner=True, error_model="numpy")
def way_from(state: Array, pose: int, R: Array, x: float, y: float, z: float) -> Way:
    """Displacement and rotation vector from a stored pose (compiled).

    Args:
        state: Has the pose, as `set_pose` stores it.
        pose: Index of its first entry.
        R: The present rotation, shape (3, 3) [–].
        x: The present position [m].
        y: Likewise.
        z: Likewise.
    """
    trace, ax, ay, az, first = 0.0, 0.0, 0.0, 0.0, pose + 3
    for c in range(3):  # sine times axis, and trace, of R Fᵀ with F stored
        p, q, r = state[first + c], state[first + 3 + c], state[first + 6 + c]
        trace += R[0, c] * p + R[1, c] * q + R[2, c] * r
        ax += 0.5 * (R[2, c] * q - R[1, c] * r)
        ay += 0.5 * (R[0, c] * r - R[2, c] * p)
        az += 0.5 * (R[1, c] * p - R[0, c] * q)
    sine = math.sqrt(ax * ax + ay * ay + az * az)
    scale = math.atan2(sine, 0.5 * (trace - 1.0)) / sine if sine > 0.0 else 1.0
    dx, dy, dz = x - state[pose], y - state[pose + 1], z - state[pose + 2]
    return dx, dy, dz, scale * ax, scale * ay, scale * az


@compiled(inner=True, error_model="numpy")
def _between(motion: Array, pose: int, other: int) -> Way:
    """Displacement and rotation vector between poses of the state (compiled)."""
    R = motion[other + 3 : other + POSE].reshape((3, 3))
    x, y, z = motion[other], motion[other + 1], motion[other + 2]
    way: Way = way_from(motion, pose, R, x, y, z)
    return way


@compiled(inner=True, error_model="numpy")
def _move(motion: Array, pose: int, way: Way, shifts: float, turns: float) -> None:
    """Move a pose of the state by fractions of both (compiled)."""
    for i in range(3):
        motion[pose + i] += shifts * way[i]
    x, y, z = turns * way[3], turns * way[4], turns * way[5]
    angle = math.sqrt(x * x + y * y + z * z)
    if angle == 0.0:
        return
    ax, ay, az = x / angle, y / angle, z / angle
    # F ← exp(angle·axis) F, column by column (Rodrigues)
    cosine, sine = math.cos(angle), math.sin(angle)
    for c in range(pose + 3, pose + 6):
        x, y, z = motion[c], motion[c + 3], motion[c + 6]
        along = (1.0 - cosine) * (ax * x + ay * y + az * z)
        motion[c] = cosine * x + sine * (ay * z - az * y) + along * ax
        motion[c + 3] = cosine * y + sine * (az * x - ax * z) + along * ay
        motion[c + 6] = cosine * z + sine * (ax * y - ay * x) + along * az
