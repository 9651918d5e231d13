"""Estimate of the probe's twist from successive poses and their times.

Differences of poses 1 ms apart that jitter by ±0.05 mm have ±100 mm/s of noise, and
drag along them would chatter. The twist is therefore estimated in two steps:

- Play operator (backlash): a follower pose stays while the probe is within a radius ρ
  of it, and within the angle ρ/ℓ (ℓ the shell's rms radius); beyond, it is dragged
  along by the excess only. Jitter within ρ leaves the follower exactly at rest, and the
  direction of a moving follower follows from the last ρ of travel, not from a single
  difference.
- First-order low pass of time constant T on the follower's velocity.

The price is delay: T in time, a travel of ρ before a start is noticed, and of 2ρ before
a reversal. Over that stretch drag still has its old direction and may do work on the
probe: friction is dissipative for the twist it is given (`ttus_opt.haptic.drag`), not
for one that lags. A caller who knows the twist should pass it. A constant velocity is
estimated exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.compiled import compiled
from ttus_opt.contact.rows import rotated
from ttus_opt.errors import InputError

#: Indices in a motion's state: 1 when a pose is known; its time; the follower's
#: position and rotation; filtered velocity of the reference point and angular velocity
KNOWN, TIME, PLACE, ROTATION, VELOCITY, MOTION = 0, 1, 2, 5, 14, 20

#: Indices in `MotionFilter.kernel_numbers`
PLAY, ANGLE, SECONDS, GAP = 0, 1, 2, 3


@dataclass(frozen=True)
class MotionFilter:
    """Parameters of the estimate of a twist from poses.

    Attributes:
        play: ρ, jitter within this radius counts as rest [m].
        seconds: T, time constant of the low pass [s].
        gap: After a longer pause between poses the estimate restarts from rest [s].
    """

    play: float = 1e-4
    seconds: float = 0.02
    gap: float = 0.25

    def __post_init__(self) -> None:
        """Refuse a value that is not positive and finite."""
        for name in ("play", "seconds", "gap"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name} must be positive, got {value}")

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
        motion[KNOWN] = 1.0
        motion[PLACE], motion[PLACE + 1], motion[PLACE + 2] = (
            at[0] + x,
            at[1] + y,
            at[2] + z,
        )
        for i in range(9):
            motion[ROTATION + i] = R[i // 3, i % 3]
        for i in range(6):
            motion[VELOCITY + i] = 0.0
    elif step > 0.0:
        kept = math.exp(-step / numbers[SECONDS])
        dx, dy, dz = _drawn(motion, at[0] + x, at[1] + y, at[2] + z, numbers[PLAY])
        wx, wy, wz = _turned(motion, R, numbers[ANGLE])
        moved = (dx, dy, dz, wx, wy, wz)
        for i in range(6):
            v = motion[VELOCITY + i]
            motion[VELOCITY + i] = kept * v + (1.0 - kept) * moved[i] / step
    motion[TIME] = time
    wx, wy, wz = motion[VELOCITY + 3], motion[VELOCITY + 4], motion[VELOCITY + 5]
    twist[0] = motion[VELOCITY] - (wy * z - wz * y)
    twist[1] = motion[VELOCITY + 1] - (wz * x - wx * z)
    twist[2] = motion[VELOCITY + 2] - (wx * y - wy * x)
    twist[3], twist[4], twist[5] = wx, wy, wz
    return True


@compiled(inline="always")
def turn_between(
    R: Array, state: Array, first: int
) -> tuple[float, float, float, float, float]:
    """The rotation T = R Fᵀ from a stored rotation F to R (compiled).

    Args:
        R: Rotation, shape (3, 3) [–].
        state: An array that contains F row by row.
        first: Index of the first entry of F.

    Returns:
        sin φ times the axis of T, from its antisymmetric part; sin φ ≥ 0; φ [rad].
    """
    trace, ax, ay, az = 0.0, 0.0, 0.0, 0.0
    for c in range(3):
        p, q, r = state[first + c], state[first + 3 + c], state[first + 6 + c]
        trace += R[0, c] * p + R[1, c] * q + R[2, c] * r
        ax += 0.5 * (R[2, c] * q - R[1, c] * r)
        ay += 0.5 * (R[0, c] * r - R[2, c] * p)
        az += 0.5 * (R[1, c] * p - R[0, c] * q)
    sine = math.sqrt(ax * ax + ay * ay + az * az)
    return ax, ay, az, sine, math.atan2(sine, 0.5 * (trace - 1.0))


@compiled(inline="always")
def _drawn(
    motion: Array, x: float, y: float, z: float, play: float
) -> tuple[float, float, float]:
    """Move the follower to within the play of a point; its displacement (compiled)."""
    dx, dy, dz = x - motion[PLACE], y - motion[PLACE + 1], z - motion[PLACE + 2]
    away = math.sqrt(dx * dx + dy * dy + dz * dz)
    if away <= play:
        return 0.0, 0.0, 0.0
    share = 1.0 - play / away
    dx, dy, dz = share * dx, share * dy, share * dz
    motion[PLACE] += dx
    motion[PLACE + 1] += dy
    motion[PLACE + 2] += dz
    return dx, dy, dz


@compiled(inline="always")
def _turned(motion: Array, R: Array, play: float) -> tuple[float, float, float]:
    """Rotate the follower to within the play of R; its rotation vector (compiled)."""
    ax, ay, az, sine, angle = turn_between(R, motion, ROTATION)
    if angle <= play or sine == 0.0:
        return 0.0, 0.0, 0.0
    ax, ay, az = ax / sine, ay / sine, az / sine
    # F ← exp(−play·axis) R, column by column (Rodrigues)
    cosine, slant = math.cos(play), -math.sin(play)
    for c in range(3):
        x, y, z = R[0, c], R[1, c], R[2, c]
        along = (1.0 - cosine) * (ax * x + ay * y + az * z)
        motion[ROTATION + c] = cosine * x + slant * (ay * z - az * y) + along * ax
        motion[ROTATION + 3 + c] = cosine * y + slant * (az * x - ax * z) + along * ay
        motion[ROTATION + 6 + c] = cosine * z + slant * (ax * y - ay * x) + along * az
    turn = angle - play
    return turn * ax, turn * ay, turn * az
