"""The offset between two clocks, by correlation (docs/method.md, 20.1).

Two devices saw the same motion: angular speeds of two trackers, contact as the force
sensor has it and as the pose has it, or how fast gravity turns in the axes of a force
sensor held in free air. Both signals are laid on one step; the offset is the lag with
the highest correlation coefficient, refined by a parabola.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ttus_opt.arrays import Array
from ttus_opt.errors import InputError
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.scan.surface import Surface

#: Offsets looked for by default [s]
LARGEST_OFFSET = 5.0

#: Steps on which signals are laid at most
MOST_STEPS = 200_000

#: Signals must overlap for so much of the shorter one
LEAST_OVERLAP = 0.5

#: Correlation below which two signals do not show the same motion
LEAST_CORRELATION = 0.5

#: A second peak nearer to the first than this is as good: periodic motion
RIVAL = 0.97

#: Force above which a sensor is in contact [N]
CONTACT = 0.5

#: Slopes are those between the means of two halves of this span [s]
SPAN = 0.3

#: A signal lasts over gaps up to so many of its usual steps
GAP_STEPS = 5.0


class Signal(NamedTuple):
    """A quantity over time.

    Attributes:
        time: Increasing, shape (T,) [s].
        values: Shape (T,).
    """

    time: Array
    values: Array


class Offset(NamedTuple):
    """What the second clock is behind the first.

    Attributes:
        seconds: To be added to the second signal's times.
        correlation: Coefficient at this offset.
        rival: The highest one elsewhere, beyond the first peak.
    """

    seconds: float
    correlation: float
    rival: float


def angular_speed(poses: Trajectory) -> Signal:
    """How fast a probe turns, the same in every frame [rad/s]."""
    return Signal(poses.time, np.linalg.norm(poses.angular_velocity(), axis=1))


def contact_of_force(time: Array, force: Array) -> Signal:
    """1 in contact and 0 off it, from forces (T, 3) [N]."""
    return Signal(time, (np.linalg.norm(force, axis=1) > CONTACT).astype(float))


def contact_of_poses(poses: Trajectory, surface: Surface, share: float) -> Signal:
    """1 where the probe is deepest, 0 elsewhere.

    How deep the probe's frame is when its shell begins to touch need not be known: the
    deepest frames are in contact, as many as the force sensor has in contact.

    Args:
        poses: Probe to patient.
        surface: The patient's.
        share: Part of the frames in contact, 0 to 1.

    Raises:
        InputError: None or all of the frames are in contact.
    """
    if not 0.0 < share < 1.0:
        raise InputError(
            f"{100 * share:.0f} % of the forces are in contact: the offset needs a "
            "recording that goes into contact and off it"
        )
    x, y, z = poses.position.T
    depth = surface.radius_at(np.arctan2(y, x), z) - np.hypot(x, y)
    return Signal(poses.time, (depth > np.quantile(depth, 1.0 - share)).astype(float))


def gravity_of_poses(poses: Trajectory, down: ArrayLike) -> Signal:
    """How fast gravity turns in a probe's axes, |d(Rᵀ g/‖g‖)/dt| [1/s].

    Args:
        poses: Probe to the frame of ``down``.
        down: Direction of gravity there, shape (3,).
    """
    direction = np.asarray(down, np.float64)
    own = np.einsum("tji,j->ti", poses.rotation, direction / np.linalg.norm(direction))
    return _slope(poses.time, own)


def gravity_of_readings(time: Array, force: Array) -> Signal:
    """How fast raw forces change, |df/dt| [N/s].

    In free air they are bias and weight, so this is the weight times the same of the
    poses, whatever bias, weight, axes and sign of the sensor are.
    """
    return _slope(time, force)


def clock_offset(
    first: Signal,
    second: Signal,
    *,
    around: float = 0.0,
    largest: float = LARGEST_OFFSET,
) -> Offset:
    """By how much the second clock is behind the first.

    Args:
        first: A signal on the first clock.
        second: The same motion on the second.
        around: Middle of the offsets that are looked for [s].
        largest: How far from there they reach [s].

    Raises:
        InputError: Signals too short, constant or unlike, an offset at the edge of what
            was looked for, or two offsets that are equally good.
    """
    if not (0.0 < largest < 1e6 and np.isfinite(around)):
        raise InputError(
            f"offsets are looked for around {around:g} ± {largest:g} s: give finite "
            "numbers, the second positive"
        )
    steps = [_step(signal) for signal in (first, second)]
    step = min(steps)
    a, b = (
        _laid(signal, step, GAP_STEPS * own)
        for signal, own in zip((first, second), steps, strict=True)
    )
    apart = float(second.time[0] - first.time[0])
    middle, reach = round((apart + around) / step), int(np.ceil(largest / step))
    if reach > MOST_STEPS:
        raise InputError(
            f"±{largest:g} s in steps of {step:.3g} s are too many offsets: look for "
            "smaller ones"
        )
    lags = np.arange(middle - reach, middle + reach + 1)
    found = np.array([_correlation(a, b, int(lag)) for lag in lags])
    best = int(np.argmax(found))
    if not found[best] > LEAST_CORRELATION:
        raise InputError(
            f"the signals correlate by {max(float(found[best]), 0.0):.2f} at most, "
            f"{LEAST_CORRELATION:g} is needed: the same motion, within {around:.3g} ± "
            f"{largest:g} s? They begin {apart:.6g} s apart"
        )
    if best in (0, len(lags) - 1):
        raise InputError(
            f"the offset is {lags[best] * step - apart:.3g} s or beyond: look further "
            f"than {around:.3g} ± {largest:g} s"
        )
    rival = _rival(found, best)
    if rival > RIVAL * found[best]:
        raise InputError(
            f"two offsets correlate by {found[best]:.3f} and {rival:.3f}: the motion "
            "repeats itself; record an irregular one, or look for a smaller offset"
        )
    low, mid, high = found[best - 1 : best + 2]
    bend = low - 2.0 * mid + high
    part = 0.5 * (low - high) / bend if bend < 0 else 0.0
    seconds = float((lags[best] + part) * step) - apart
    return Offset(seconds, float(mid), rival)


def _slope(time: Array, values: Array) -> Signal:
    """Length of the slope of vectors (T, 3) over `SPAN`, where both halves are known.

    Raises:
        InputError: The recording is shorter.
    """
    before = np.searchsorted(time, time - 0.5 * SPAN)
    after = np.searchsorted(time, time + 0.5 * SPAN, side="right")
    here = np.arange(len(time))
    both = (time - 0.5 * SPAN >= time[0]) & (time + 0.5 * SPAN <= time[-1])
    both &= (before < here) & (after > here + 1)
    if not both.any():
        raise InputError(
            f"a recording of {np.ptp(time):.3g} s tells no slopes over {SPAN:g} s"
        )
    columns = np.concatenate([time[:, None] - time[0], values], axis=1)
    total = np.concatenate([np.zeros((1, 4)), np.cumsum(columns, axis=0)])
    i, low, high = here[both], before[both], after[both]
    first = (total[i] - total[low]) / (i - low)[:, None]
    second = (total[high] - total[i + 1]) / (high - i - 1)[:, None]
    change = second - first
    slope = np.linalg.norm(change[:, 1:], axis=1) / change[:, 0]
    return Signal(time[both], slope)


def _step(signal: Signal) -> float:
    """The usual step of a signal [s].

    Raises:
        InputError: It is too short, not finite or constant.
    """
    if len(signal.time) < 10:
        raise InputError(
            f"a signal of {len(signal.time)} frames tells no offset: at least 10"
        )
    if not (np.isfinite(signal.time).all() and np.isfinite(signal.values).all()):
        raise InputError("a signal contains NaN or infinity: drop those frames")
    step = float(np.median(np.diff(signal.time)))
    if not step > 0.0:
        raise InputError("times of a signal must increase [s]: sort them")
    if np.ptp(signal.values) == 0.0:
        raise InputError(
            "a signal is constant: nothing turns, or nothing touches, in one of the "
            "recordings"
        )
    return step


def _laid(signal: Signal, step: float, gap: float) -> Array:
    """A signal on equal steps from its beginning; NaN in gaps."""
    count = int((signal.time[-1] - signal.time[0]) / step) + 1
    if count > MOST_STEPS:
        raise InputError(
            f"{count:,} steps of {step:.3g} s are too many, {MOST_STEPS:,} are looked "
            "at: give a shorter part of the recording"
        )
    time = signal.time[0] + step * np.arange(count)
    values = np.array(np.interp(time, signal.time, signal.values), np.float64)
    after = np.clip(np.searchsorted(signal.time, time), 1, len(signal.time) - 1)
    values[signal.time[after] - signal.time[after - 1] > gap] = np.nan
    return values


def _correlation(a: Array, b: Array, lag: int) -> float:
    """Coefficient of a and of b moved later by some steps, where both are known."""
    first, second = max(lag, 0), max(-lag, 0)
    n = min(len(a) - first, len(b) - second)  # a[lag + k] belongs to b[k]
    known = min(np.isfinite(a).sum(), np.isfinite(b).sum())
    if n < 2:
        return -1.0
    x, y = a[first : first + n], b[second : second + n]
    both = np.isfinite(x) & np.isfinite(y)
    if both.sum() < max(LEAST_OVERLAP * known, 8):
        return -1.0
    x, y = x[both] - x[both].mean(), y[both] - y[both].mean()
    square = float((x @ x) * (y @ y))
    return float(x @ y) / np.sqrt(square) if square > 0.0 else -1.0


def _rival(found: Array, best: int) -> float:
    """The highest local peak other than the one that contains the best."""
    inner = found[1:-1]
    peaks = 1 + np.flatnonzero((inner >= found[:-2]) & (inner > found[2:]))
    others = []
    for peak in map(int, peaks):
        between = found[min(peak, best) : max(peak, best) + 1]
        if between.min() < 0.8 * found[peak]:  # another peak has a valley before it
            others.append(float(found[peak]))
    return max(others, default=-1.0)
