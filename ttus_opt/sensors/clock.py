"""The offset between two clocks, by correlation (docs/method/sensors.md, 20.1).

Two devices recorded the same motion: the angular speed of two trackers, contact from
the force sensor and from the pose, or the rate at which gravity turns in the axes of a
force sensor held in free air. Both signals are resampled to one step; the offset is the
lag with the highest correlation coefficient, refined by a parabola.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import irfft, next_fast_len, rfft

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import InputError
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.scan.surface import Surface
from ttus_opt.sensors.streams import within

#: Default search range [s]
LARGEST_OFFSET = 5.0

#: Most samples of a resampled signal
MOST_STEPS = 200_000

#: Least overlap, as a fraction of the shorter signal
LEAST_OVERLAP = 0.5

#: Less variance than this part of all of a signal's is rounding
ROUNDING = 1e-10

#: Correlation below which two signals do not show the same motion
LEAST_CORRELATION = 0.5

#: A second peak above this fraction of the first is ambiguous: periodic motion
RIVAL = 0.97

#: Force above which a sensor is in contact [N]
CONTACT = 0.5

#: Largest distance of a pose's origin from the skin in contact [m]
FARTHEST = 0.5

#: A slope is taken between the means of the two halves of this span [s]
SPAN = 0.3

#: Parts of a recording between which the offset's error is estimated
PARTS = 8

#: Error of the parabola between samples [steps]
ROUNDED = 0.05

#: Longest gap that is interpolated over [median steps]
GAP_STEPS = 5.0


class UnlikeSignalsError(InputError):
    """Two signals that do not show one motion within the searched offsets."""


class Signal(NamedTuple):
    """A quantity over time.

    Attributes:
        time: Increasing, shape (T,) [s].
        values: Shape (T,).
    """

    time: Array
    values: Array


class Offset(NamedTuple):
    """How far the second clock is behind the first.

    Attributes:
        seconds: Seconds to add to the second signal's times.
        correlation: Coefficient at this offset.
        rival: Coefficient of the next highest peak.
        std: Standard error of ``seconds``, from the scatter between parts of the
            recording [s].
    """

    seconds: float
    correlation: float
    rival: float
    std: float


def contact_of_force(time: Array, force: Array) -> Signal:
    """1 in contact and 0 off it, from forces (T, 3) [N]."""
    return Signal(time, (np.linalg.norm(force, axis=1) > CONTACT).astype(float))


def contact_of_poses(poses: Trajectory, surface: Surface, share: float) -> Signal:
    """1 where the probe is deepest, 0 elsewhere.

    The depth at which the shell begins to touch need not be known: the deepest frames
    count as contact, in the same proportion as the force sensor's.

    Args:
        poses: Probe to patient.
        surface: Surface of the patient.
        share: Fraction of the frames in contact.

    Raises:
        UnlikeSignalsError: The poses are not at the skin.
        InputError: The fraction is 0 or 1, or too few poses.
    """
    _require_length(poses.time)
    if not 0.0 < share < 1.0:
        raise InputError(
            f"{100 * share:.0f} % of the forces are in contact: the offset needs a "
            "recording that makes and breaks contact"
        )
    depth, z = surface.depth_of(poses.position), poses.position[:, 2]
    deep = depth > np.quantile(depth, 1.0 - share)
    beside = z - np.clip(z, surface.z[0], surface.z[-1])
    away = float(np.median(np.hypot(depth, beside)[deep]))
    if away > FARTHEST:
        raise UnlikeSignalsError(
            f"the poses are {away:.2g} m from the skin where they are deepest, which "
            "no probe is long: not in the surface's frame?"
        )
    return Signal(poses.time, deep.astype(float))


def gravity_of_poses(poses: Trajectory, down: ArrayLike) -> Signal:
    """Rate at which gravity turns in the probe's axes, |d(Rᵀ g/‖g‖)/dt| [1/s].

    Args:
        poses: Probe to the frame of ``down``.
        down: Direction of gravity, shape (3,).
    """
    direction = np.asarray(down, np.float64)
    own = np.einsum("tji,j->ti", poses.rotation, direction / np.linalg.norm(direction))
    return _slope(poses.time, own)


def gravity_of_readings(time: Array, force: Array) -> Signal:
    """Rate of change of raw forces, |df/dt| [N/s].

    In free air raw forces are bias plus weight, so this is the weight times
    `gravity_of_poses`, whatever the sensor's bias, axes and sign.
    """
    return _slope(time, force)


def clock_offset(
    first: Signal,
    second: Signal,
    *,
    around: float = 0.0,
    largest: float = LARGEST_OFFSET,
) -> Offset:
    """How far the second clock is behind the first.

    Args:
        first: A signal on the first clock.
        second: The same motion on the second.
        around: Centre of the search range [s].
        largest: Half its width [s].

    Raises:
        UnlikeSignalsError: The signals are unlike.
        InputError: Signals too short or constant, an offset at the edge of the search
            range, or two offsets that fit equally well.
    """
    if not (0.0 < largest < 1e6 and np.isfinite(around)):
        raise InputError(
            f"the search range is {around:g} ± {largest:g} s: give finite numbers, the "
            "second positive"
        )
    steps = [_step(signal) for signal in (first, second)]
    step = min(steps)
    a, b = (
        _resampled(signal, step, GAP_STEPS * own)
        for signal, own in zip((first, second), steps, strict=True)
    )
    apart = float(second.time[0] - first.time[0])
    middle, reach = round((apart + around) / step), int(np.ceil(largest / step))
    if reach > MOST_STEPS:
        raise InputError(
            f"±{largest:g} s in steps of {step:.3g} s are too many offsets: narrow the "
            "search range"
        )
    lags = np.arange(middle - reach, middle + reach + 1)
    found = _correlations(a, b, lags)
    best = int(np.argmax(found))
    if not found[best] > LEAST_CORRELATION:
        raise UnlikeSignalsError(
            f"the signals correlate by {max(float(found[best]), 0.0):.2f} at most, "
            f"{LEAST_CORRELATION:g} is needed: the same motion, within {around:.6g} ± "
            f"{largest:g} s? They begin {apart:.6g} s apart"
        )
    if best in (0, len(lags) - 1):
        raise InputError(
            f"the offset is {lags[best] * step - apart:.3g} s or beyond: search wider "
            f"than {around:.6g} ± {largest:g} s"
        )
    rival = _rival(found, best)
    if rival > RIVAL * found[best]:
        raise InputError(
            f"two offsets correlate by {found[best]:.3f} and {rival:.3f}: the motion "
            "repeats itself; record an irregular one, or search less far than "
            f"largest={largest:g}"
        )
    low, mid, high = found[best - 1 : best + 2]
    bend = low - 2.0 * mid + high
    part = 0.5 * (low - high) / bend if bend < 0 else 0.0
    seconds = float((lags[best] + part) * step) - apart
    return Offset(seconds, float(mid), rival, step * _std(a, b, int(lags[best])))


def _slope(time: Array, values: Array) -> Signal:
    """Norm of the slope of (T, 3) over `SPAN`, where both halves have samples."""
    before = np.searchsorted(time, time - 0.5 * SPAN)
    after = np.searchsorted(time, time + 0.5 * SPAN, side="right")
    here = np.arange(len(time))
    both = (time - 0.5 * SPAN >= time[0]) & (time + 0.5 * SPAN <= time[-1])
    both &= (before < here) & (after > here + 1)
    if not both.any():
        raise InputError(
            f"a recording of {np.ptp(time):.3g} s is too short for slopes over "
            f"{SPAN:g} s: record longer"
        )
    columns = np.concatenate([time[:, None] - time[0], values], axis=1)
    total = np.concatenate([np.zeros((1, 4)), np.cumsum(columns, axis=0)])
    i, low, high = here[both], before[both], after[both]
    first = (total[i] - total[low]) / (i - low)[:, None]
    second = (total[high] - total[i + 1]) / (high - i - 1)[:, None]
    change = second - first
    slope = np.linalg.norm(change[:, 1:], axis=1) / change[:, 0]
    return Signal(time[both], slope)


def _require_length(time: Array) -> None:
    if len(time) < 10:
        raise InputError(
            f"an offset needs signals of at least 10 frames, got {len(time)}"
        )


def _step(signal: Signal) -> float:
    """The median step of a signal [s]."""
    _require_length(signal.time)
    if not (np.isfinite(signal.time).all() and np.isfinite(signal.values).all()):
        raise InputError("a signal contains NaN or infinity: drop those frames")
    step = float(np.median(np.diff(signal.time)))
    if not step > 0.0:
        raise InputError("times of a signal must increase [s]: sort them")
    if np.ptp(signal.values) == 0.0:
        raise InputError(
            "a signal is constant: in one of the recordings nothing turns, or "
            "nothing touches"
        )
    return step


def _resampled(signal: Signal, step: float, gap: float) -> Array:
    """A signal at equal steps from its beginning; NaN in gaps."""
    count = int((signal.time[-1] - signal.time[0]) / step) + 1
    if count > MOST_STEPS:
        raise InputError(
            f"{count:,} steps of {step:.3g} s are too many, at most {MOST_STEPS:,}: "
            "give a shorter part of the recording"
        )
    time = signal.time[0] + step * np.arange(count)
    values = np.array(np.interp(time, signal.time, signal.values), np.float64)
    values[~within(time, signal.time, gap)] = np.nan
    return values


def _correlations(a: Array, b: Array, lags: IntArray) -> Array:
    """Correlation coefficients of a and b, b delayed by each number of steps.

    By Fourier transforms: sums over what both know at a lag. −1 for too short an
    overlap, or where one is constant.
    """
    known = [np.isfinite(values) for values in (a, b)]
    size = next_fast_len(len(a) + len(b), real=True)
    powers = []
    for values, own in zip((a, b), known, strict=True):
        off = np.where(own, values - values[own].mean(), 0.0)
        powers.append([rfft(off**power * own, size) for power in range(3)])

    def summed(first: int, second: int) -> Array:
        """Sums of powers of a and b over the overlap at each lag."""
        product = powers[0][first] * powers[1][second].conj()
        return np.asarray(irfft(product, size)[lags % size])

    count = np.round(summed(0, 0))
    count[(lags <= -len(b)) | (lags >= len(a))] = 0.0
    enough = count >= max(LEAST_OVERLAP * min(own.sum() for own in known), 8)
    n = np.where(enough, count, 1.0)
    x, y, xx, yy = summed(1, 0), summed(0, 1), summed(2, 0), summed(0, 2)
    variances = [xx - x**2 / n, yy - y**2 / n]
    for variance, whole in zip(variances, (xx, yy), strict=True):
        enough &= variance > ROUNDING * whole.max()
    square = np.where(enough, variances[0] * variances[1], 1.0)
    return np.where(enough, (summed(1, 1) - x * y / n) / np.sqrt(square), -1.0)


def _std(a: Array, b: Array, lag: int) -> float:
    """Standard error of a lag, by a jackknife over parts of the recording [steps].

    Near the best lag a step δ of b changes the residual b − g a by g a′ δ: the least
    squares δ of every part but one scatter as the lag does, whatever the correlation of
    the noise within a part.
    """
    first, second = max(lag, 0), max(-lag, 0)
    n = max(min(len(a) - first, len(b) - second), 0)  # a[lag + k] belongs to b[k]
    x, y = a[first : first + n], b[second : second + n]
    slope = 0.5 * (x[2:] - x[:-2])
    x, y = x[1:-1], y[1:-1]
    known = np.isfinite(slope) & np.isfinite(x) & np.isfinite(y)
    x, y = x - x[known].mean(), y - y[known].mean()
    gain = float(x[known] @ y[known]) / float(x[known] @ x[known])
    part = np.arange(len(x)) * PARTS // len(x)
    ups = np.where(known, slope * (y - gain * x), 0.0)
    downs = np.where(known, gain * slope**2, 0.0)
    up, down = (np.bincount(part, v, PARTS) for v in (ups, downs))
    left = (up.sum() - up) / np.maximum(down.sum() - down, 1e-300)
    spread = float(np.sqrt((PARTS - 1) / PARTS * ((left - left.mean()) ** 2).sum()))
    return float(np.hypot(spread, ROUNDED))


def _rival(found: Array, best: int) -> float:
    """The highest local peak apart from the best one."""
    inner = found[1:-1]
    peaks = 1 + np.flatnonzero((inner >= found[:-2]) & (inner > found[2:]))
    others = []
    for peak in map(int, peaks):
        between = found[min(peak, best) : max(peak, best) + 1]
        if between.min() < 0.8 * found[peak]:  # another peak has a valley before it
            others.append(float(found[peak]))
    return max(others, default=-1.0)
