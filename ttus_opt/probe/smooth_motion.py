"""Velocity of a recorded probe, without the noise of its poses.

A tracker's poses jitter and drift. A drift of 0.15 mm between poses 50 ms apart is
3 mm/s, as fast as a hand slides near rest. Each axis of a recording is therefore
modelled as the motion of a hand plus the errors of a tracker,

    y_k = x(t_k) + w(t_k) + e_k,   x''' white noise of intensity q,
    w Brownian motion of intensity D,   e_k white noise of variance r:

a Wiener process acceleration (Bar-Shalom, Li, Kirubarajan 2001) plus a local level
(Harvey 1989). The velocity is the mean of x' given all frames, by a Kalman filter and
fixed-interval smoothing. q, D and r maximise the likelihood of the recording and are
common to its three axes. For exact poses D = r = 0, and x is the smoothest curve
through all of them. See docs/method/friction.md, section 7.4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.compiled import compiled
from ttus_opt.probe.recording_faults import unlike_neighbours

#: Fewest frames from which the noise can be estimated
LEAST_FRAMES = 20

#: A step that differs from both its neighbours by more than this [m], [rad], and by so
#: many times the median [–], is a jump of the tracker or a cut in the recording
JUMP, JUMPS = 5e-3, 10.0

#: Frames that determine the initial position, velocity and acceleration of a piece
UNKNOWN = 3

#: Central differences with less noise are used [m/s], a tenth of
#: `contact.friction.DEADBAND`: a robot's exact poses and sudden stops are not smeared
NEGLIGIBLE = 2e-4

#: Largest plausible error of a tracker in a frame [m]; with more, poses form no path
LARGEST = 5e-3

#: Lever arm by which an angular velocity moves the surface of a probe [m]
LEVER = 0.03

#: A path that moves by less in total, or is predicted better, is exact [m], [rad]
EXACT = 1e-12

#: Logarithms of q tⁿ/(D h + r) from which the search starts
STARTS = np.arange(-24.0, 13.0, 3.0)

#: Variance of the unknown initial state, over 1 + q
DIFFUSE = 1e6


@dataclass(frozen=True)
class SmoothMotion:
    """Velocity of a path, with the estimated motion and noise.

    Attributes:
        velocity: Velocity, shape (T, 3) [m/s] or [rad/s].
        std: Standard deviation of each component, shape (T,).
        known: False in pieces between two jumps that are too short, shape (T,).
        jerk: √q [m/s^2.5] or [rad/s^2.5].
        drift: √D, drift of the tracker in a second [m/√s] or [rad/√s].
        jitter: √r [m] or [rad].
        difference_std: Standard deviation of a central difference by drift and jitter,
            as a velocity at the median step. It is limited by the 90 % quantile of
            third differences, so that a few kinks do not count as noise.
    """

    velocity: Array = field(repr=False)
    std: Array = field(repr=False)
    known: Mask = field(repr=False)
    jerk: float
    drift: float
    jitter: float
    difference_std: float


def smooth_twist(
    rotation: Array, position: Array, time: Array, differences: Array
) -> Array:
    """Twist of one recording, position and rotation each with its own noise.

    Args:
        rotation: Probe to patient, shape (T, 3, 3) [–].
        position: Origin of the probe frame, shape (T, 3) [m].
        time: Increasing times, shape (T,) [s].
        differences: Twist by central differences, used where there is no better
            estimate, shape (T, 6) [m/s, rad/s].

    Returns:
        Velocity and angular velocity, patient axes, shape (T, 6) [m/s, rad/s].
    """
    summed = summed_turns(rotation)
    twist = differences.copy()
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    for path, columns, lever in (
        (position, slice(0, 3), 1.0),
        (summed, slice(3, 6), LEVER),
    ):
        found = smooth_motion(path, time)
        if found is None or lever * found.difference_std < NEGLIGIBLE:
            continue
        if lever * math.hypot(found.drift * math.sqrt(step), found.jitter) < LARGEST:
            twist[found.known, columns] = found.velocity[found.known]
    return twist


def summed_turns(rotation: Array) -> Array:
    """Sum of the small rotation vectors between frames, shape (T, 3) [rad]."""
    from scipy.spatial.transform import Rotation

    turns = np.zeros((len(rotation), 3))
    if len(rotation) > 1:
        between = rotation[1:] @ rotation[:-1].transpose(0, 2, 1)
        turns[1:] = Rotation.from_matrix(between).as_rotvec()
    return np.cumsum(turns, axis=0)


def smooth_motion(path: Array, time: Array) -> SmoothMotion | None:
    """Estimate the velocity along a path.

    Args:
        path: Positions, or the sum of small rotation vectors, shape (T, 3).
        time: Increasing times, shape (T,) [s].

    Returns:
        None where central differences are as good: with fewer than `LEAST_FRAMES`
        frames, or with frames at rest or on parabolas up to rounding.
    """
    from scipy.optimize import minimize

    if len(path) < LEAST_FRAMES or np.ptp(path, axis=0).max() < EXACT:
        return None
    path, unit, steps, starts = _in_steps(path, time)

    def cost(place: Array) -> float:
        """Minus log likelihood, at the best scale of all three."""
        ratios = _ratios(place)
        square, spread, count = _filtered(path, steps, starts, ratios, NONE)
        scale = max(square / count, EXACT**2)
        return float(0.5 * (spread + count * math.log(scale)))

    if _filtered(path, steps, starts, _ratios(np.zeros(2)), NONE)[2] == 0:
        return None  # no piece is long enough
    grid = [(share, ratio) for share in (-3.0, 3.0) for ratio in STARTS]
    best = min(grid, key=lambda place: cost(np.array(place)))
    found = minimize(
        cost,
        np.array(best),
        method="Nelder-Mead",
        bounds=[(-12.0, 12.0), (STARTS[0], STARTS[-1])],
        options={
            "xatol": 0.02,
            "fatol": 0.01,
            "initial_simplex": np.add(best, [[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]]),
        },
    )
    ratios = _ratios(found.x)
    velocity, variance, scale = _estimated(path, steps, starts, ratios)
    if scale < EXACT**2:
        return None
    jerk, drift, jitter = np.sqrt(scale * np.array(ratios))
    piece = np.cumsum(starts)
    return SmoothMotion(
        velocity / unit,
        np.sqrt(scale * variance) / unit,
        np.bincount(piece)[piece] > UNKNOWN,
        float(jerk / unit**2.5),
        float(drift / math.sqrt(unit)),
        float(jitter),
        min(math.hypot(drift, jitter) / math.sqrt(2.0), _most_noise(path)) / unit,
    )


def velocity_of(
    path: Array, time: Array, like: SmoothMotion, step: float
) -> tuple[Array, Array]:
    """Velocity along a path, smoothed as another one was, and its standard deviation.

    Args:
        path: As in `smooth_motion`.
        time: Increasing times, shape (T,) [s].
        like: The other's noise.
        step: The other's median step [s]; jitter of as many frames more or less counts
            alike.

    Returns:
        Shapes (T, 3) and (T,), the latter up to a factor: larger near the ends.
    """
    path, unit, steps, starts = _in_steps(path, time)
    drift, white = like.drift**2 * unit, like.jitter**2 * step / unit
    noise = drift + white
    ratios = like.jerk**2 * unit**5 / noise, drift / noise, white / noise
    found = _estimated(path, steps, starts, ratios)
    return found[0] / unit, np.sqrt(found[1])


def _estimated(
    path: Array, steps: Array, starts: Mask, ratios: tuple[float, float, float]
) -> tuple[Array, Array, float]:
    """Velocity (T, 3) and its variance over the scale (T,), per step; the scale."""
    kept = np.empty((len(path), KEPT))
    square, _, count = _filtered(path, steps, starts, ratios, kept)
    velocity, variance = np.empty_like(path), np.empty(len(path))
    _smoothed(steps, starts, kept, velocity, variance)
    return velocity, variance, square / max(count, 1)


def _most_noise(path: Array) -> float:
    """Upper bound of the standard deviation of central differences, per step.

    Third differences have the variances 6 D by drift and 20 r by jitter, central
    differences D/2 and r/2. Nine in ten normal vectors are shorter than 2.5 standard
    deviations.
    """
    third = np.linalg.norm(np.diff(path, 3, axis=0), axis=1)
    return float(np.quantile(third, 0.9) / 2.5 / math.sqrt(12.0))


def _in_steps(path: Array, time: Array) -> tuple[Array, float, Array, Mask]:
    """A path from its first point, the median step [s], and the steps in it (T − 1,).

    Last the frames at which it restarts: the first, and after a jump, shape (T,).
    """
    unit = float(np.median(np.diff(time)))
    steps = np.ascontiguousarray(np.diff(time) / unit)
    path = np.ascontiguousarray(path - path[0])
    off = unlike_neighbours(path, steps)
    starts = np.concatenate([[True], off > np.maximum(JUMP, JUMPS * np.median(off))])
    return path, unit, steps, starts


def _ratios(place: Array) -> tuple[float, float, float]:
    """q, D and r over D + r, time in steps: (log odds of r in D + r, log q)."""
    white = 1.0 / (1.0 + math.exp(-float(place[0])))
    return math.exp(float(place[1])), 1.0 - white, white


#: What the filter keeps of a frame: innovations of three axes and their variance; gain;
#: predicted velocities; the velocity's row of the predicted covariance, symmetric
INNOVATION, VARIANCE, GAIN, PREDICTED, COVARIANCE, KEPT = 0, 3, 4, 7, 10, 13
NONE = np.empty((0, KEPT))


@compiled(error_model="numpy", nogil=True)
def _filtered(
    path: Array, steps: Array, starts: Mask, ratios: tuple[float, float, float],
    kept: Array,
) -> tuple[float, float, int]:  # fmt: skip
    """Kalman filter of position, velocity and acceleration (compiled).

    Args:
        path: Shape (T, 3).
        steps: Between frames, shape (T − 1,).
        starts: Frames before which nothing is known, shape (T,).
        ratios: q, D, r.
        kept: For `_smoothed`, shape (T, KEPT); or (0, KEPT).

    Returns:
        Sum of squared innovations over their variances, sum of the variances'
        logarithms, and their number, without the frames that determine a start.
    """
    q, drift, white = ratios
    x, P, gain, e = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    square, spread, count, since = 0.0, 0.0, 0, 0
    for k in range(len(path)):
        if starts[k]:
            since = 0
            _start(x, P, path[k], DIFFUSE * (1.0 + q))
        else:
            since += 1
            _predict(x, P, steps[k - 1], q, drift)
        variance = P[0, 0] + white
        for i in range(3):
            e[i], gain[i] = path[k, i] - x[0, i], P[i, 0] / variance
        if len(kept) > 0:
            kept[k, VARIANCE] = variance
            for i in range(3):
                kept[k, INNOVATION + i], kept[k, GAIN + i] = e[i], gain[i]
                kept[k, PREDICTED + i], kept[k, COVARIANCE + i] = x[1, i], P[1, i]
        if since >= UNKNOWN:
            square += (e[0] * e[0] + e[1] * e[1] + e[2] * e[2]) / variance
            spread += 3.0 * math.log(variance)
            count += 3
        _correct(x, P, gain, e)
    return square, spread, count


@compiled(error_model="numpy", nogil=True)
def _start(x: Array, P: Array, first: Array, variance: float) -> None:
    """Know the first frame alone: state x[state, axis], covariance P (compiled)."""
    x[:], P[:] = 0.0, 0.0
    for i in range(3):
        x[0, i], P[i, i] = first[i], variance


@compiled(error_model="numpy", nogil=True)
def _predict(x: Array, P: Array, d: float, q: float, drift: float) -> None:
    """Predict over a step d: x ← F x, P ← F P Fᵀ + Q (compiled)."""
    half = 0.5 * d * d
    for a in range(3):
        x[0, a] += d * x[1, a] + half * x[2, a]
        x[1, a] += d * x[2, a]
    for a in range(3):  # F P
        P[0, a] += d * P[1, a] + half * P[2, a]
        P[1, a] += d * P[2, a]
    for a in range(3):  # times Fᵀ
        P[a, 0] += d * P[a, 1] + half * P[a, 2]
        P[a, 1] += d * P[a, 2]
    P[0, 0] += drift * d + q * d**5 / 20.0
    P[0, 1] += q * d**4 / 8.0
    P[0, 2] += q * d**3 / 6.0
    P[1, 1] += q * d**3 / 3.0
    P[1, 2] += q * d * d / 2.0
    P[2, 2] += q * d
    P[1, 0], P[2, 0], P[2, 1] = P[0, 1], P[0, 2], P[1, 2]


@compiled(error_model="numpy", nogil=True)
def _correct(x: Array, P: Array, gain: Array, innovation: Array) -> None:
    """Correct by a frame: x ← x + K eᵀ, P ← (I − K Z) P (compiled)."""
    for i in range(2, -1, -1):  # the first row of P last: the others need it
        for a in range(3):
            x[i, a] += gain[i] * innovation[a]
            P[i, a] -= gain[i] * P[0, a]
    P[1, 0], P[2, 0], P[2, 1] = P[0, 1], P[0, 2], P[1, 2]


@compiled(error_model="numpy", nogil=True)
def _smoothed(
    steps: Array, starts: Mask, kept: Array, velocity: Array, variance: Array
) -> None:
    """Velocities given all frames, backwards and without an inverse (compiled).

    With Z = (1, 0, 0), L = F (I − K Z), innovations e and their variances S (de Jong
    1989): r ← Zᵀe/S + (I − K Z)ᵀFᵀr, N alike, x̂ = x + P r, V = P − P N P.

    Args:
        steps: Between frames, shape (T − 1,).
        starts: Frames before which nothing is known, shape (T,).
        kept: Of `_filtered`, shape (T, KEPT).
        velocity: Out, shape (T, 3).
        variance: Out, of a component, shape (T,).
    """
    r, N = np.zeros((3, 3)), np.zeros((3, 3))  # r[state, axis]
    L, other = np.eye(3), np.zeros((3, 3))
    for k in range(len(kept) - 1, -1, -1):
        S, d = kept[k, VARIANCE], 0.0
        if k == len(steps) or starts[k + 1]:
            r[:] = 0.0
            N[:] = 0.0
        else:
            d = steps[k]
        # L: the first column of F less F K
        k0, k1, k2 = kept[k, GAIN], kept[k, GAIN + 1], kept[k, GAIN + 2]
        L[0, 1], L[0, 2], L[1, 2] = d, 0.5 * d * d, d
        L[0, 0] = 1.0 - (k0 + d * k1 + 0.5 * d * d * k2)
        L[1, 0], L[2, 0] = -(k1 + d * k2), -k2
        other[:] = L.T @ r
        for a in range(3):
            other[0, a] += kept[k, INNOVATION + a] / S
        r[:] = other
        other[:] = L.T @ N @ L
        other[0, 0] += 1.0 / S
        N[:] = other
        spread = kept[k, COVARIANCE + 1]
        for a in range(3):
            velocity[k, a] = kept[k, PREDICTED + a]
            for i in range(3):
                velocity[k, a] += kept[k, COVARIANCE + i] * r[i, a]
                spread -= kept[k, COVARIANCE + i] * N[i, a] * kept[k, COVARIANCE + a]
        variance[k] = max(spread, 0.0)
