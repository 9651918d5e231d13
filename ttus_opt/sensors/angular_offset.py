"""The offset of two clocks by the angular speed of one body that both devices saw.

Speeds of noisy poses need smoothing (docs/method/friction.md, 7.4). Both are smoothed
alike: a smoothed speed against another one would be late or early wherever motion
begins faster than it ends. The standard error is found by repetition, with noise as the
poses show.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.errors import InputError
from ttus_opt.probe.smooth_motion import (
    EXACT,
    LEAST_FRAMES,
    SmoothMotion,
    smooth_motion,
    summed_turns,
    velocity_of,
)
from ttus_opt.probe.trajectory import Trajectory, interpolated
from ttus_opt.sensors.clock import LARGEST_OFFSET, Offset, Signal, clock_offset

#: Smoothed speeds with more than this many times the median error are left out: a
#: smoother knows less near the ends
CERTAIN = 1.05

#: Repetitions by which the standard error is found, to 20 %
REPEATS = 12


class _Noise(NamedTuple):
    """What a recording's poses show.

    Attributes:
        motion: Its motion and noise.
        step: Its median step [s].
    """

    motion: SmoothMotion
    step: float

    @property
    def bandwidth(self) -> float:
        """Of the smoother, (jerk²/density of the noise)^(1/6) [1/s]."""
        noise = (self.motion.jitter**2 + self.motion.drift**2 * self.step) * self.step
        return float((self.motion.jerk**2 / noise) ** (1.0 / 6.0))


def angular_offset(
    first: Trajectory,
    second: Trajectory,
    *,
    around: float = 0.0,
    largest: float = LARGEST_OFFSET,
) -> Offset:
    """`clock_offset` of the angular speeds, which are the same in every frame.

    Computed twice, the second time from the span that both saw: ends at different
    moments, where a smoother knows less, would be an offset of their own.

    Args:
        first: Poses on the first clock, any frame.
        second: Poses of the same body, or of one fixed to it, on the second clock.
        around: As in `clock_offset`.
        largest: As in `clock_offset`.

    Raises:
        InputError: As `clock_offset`.
    """
    noises = [_noise(poses) for poses in (first, second)]
    known = [noise for noise in noises if noise is not None]
    smoother = min(known, key=lambda noise: noise.bandwidth, default=None)

    def compared(pair: tuple[Trajectory, Trajectory], around: float) -> Offset:
        speeds = (_signal(*_velocity(poses, smoother)) for poses in pair)
        return clock_offset(*speeds, around=around, largest=largest)

    found = compared((first, second), around)
    if smoother is None:
        return found
    later = second.time + found.seconds
    begin, end = max(first.time[0], later[0]), min(first.time[-1], later[-1])
    both = (
        first.select((first.time >= begin) & (first.time <= end)),
        second.select((later >= begin) & (later <= end)),
    )
    found = compared(both, found.seconds)
    scatter = _scatter(both, noises, smoother, found.seconds)
    return found._replace(std=float(np.hypot(found.std, scatter)))


def _noise(poses: Trajectory) -> _Noise | None:
    """Noise of the longest segment; None where differences are as good."""
    longest = max(poses.recordings, key=len)
    found = smooth_motion(summed_turns(longest.rotation), longest.time)
    if found is None or found.jitter + found.drift == 0.0:
        return None
    return _Noise(found, float(np.median(np.diff(longest.time))))


def _velocity(
    poses: Trajectory, smoother: _Noise | None, path: Array | None = None
) -> tuple[Array, Array]:
    """Times, and angular velocity by differences or smoothed, without uncertain ends.

    Args:
        poses: Times, segments and rotations.
        smoother: As whose poses they are smoothed; None for differences.
        path: Rotation vectors to smooth, shape (T, 3) [rad]; by default the poses'.
    """
    velocity = poses.angular_velocity()
    if smoother is None:
        return poses.time, velocity
    good: Mask = np.ones(len(poses), bool)
    for own in poses.parts:
        if own.stop - own.start < LEAST_FRAMES:
            continue
        turned = summed_turns(poses.rotation[own]) if path is None else path[own]
        velocity[own], std = velocity_of(turned, poses.time[own], *smoother)
        good[own] = std < CERTAIN * np.median(std)
    return poses.time[good], velocity[good]


def _signal(time: Array, velocity: Array) -> Signal:
    return Signal(time, np.linalg.norm(velocity, axis=1))


def _scatter(
    both: tuple[Trajectory, Trajectory],
    noises: list[_Noise | None],
    smoother: _Noise,
    offset: float,
) -> float:
    """Root mean square of the offset found where there is none, with fresh noise [s].

    The motion is that of the recording with less noise. Noise is jitter: what looks
    like drift may as well be slow motion.
    """
    rng = np.random.default_rng(0)
    clean = min(
        (0, 1), key=lambda i: 0.0 if (n := noises[i]) is None else n.motion.jitter
    )
    time, motion = _velocity(both[clean], smoother)
    time = time + (offset if clean == 1 else 0.0)
    errors = []
    for _ in range(REPEATS):
        signals = []
        for poses, noise, shift in zip(both, noises, (0.0, offset), strict=True):
            jitter = 0.0 if noise is None else noise.motion.jitter
            path = rng.normal(0.0, max(jitter, EXACT), (len(poses), 3))
            own, errs = _velocity(poses, smoother, path)
            at = own + shift
            inside = (at >= time[0]) & (at <= time[-1])
            true = interpolated(at, time, motion)
            signals.append(_signal(at[inside], (true + errs)[inside]))
        try:
            errors.append(clock_offset(*signals).seconds)
        except InputError:  # the motion is hardly seen
            errors.append(LARGEST_OFFSET)
    return float(np.sqrt(np.mean(np.square(errors))))
