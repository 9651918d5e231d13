"""The contour of a section: a Kalman filter over the angle (paper, eqs. 1-5).

The state is the radius d and its slope g = dd/dθ, an integrated Ornstein-Uhlenbeck
process: a smooth contour whose slope is correlated over `slope_angle`, so that the
radius levels off over a long unseen stretch. The measurement is the probabilistic data
association of the candidates r_i of a spoke,

    β_i ∝ Normal(r_i; d̂, S) · D_i,   y = Σ β_i r_i.

Three departures from the paper. r_i replaces the y that it prints in y's own
definition. S is the variance of the innovation r_i - d̂, S = P + σ², the sum of those of
the prediction and of a point. And D, which makes a far surface (the bed) unlikely, is
one number per *surface*: candidates closer than `_SAME_SURFACE` σ to the next belong
together and share the D of their mean. D then chooses between surfaces but not among
the noisy points of one, where it would favour the near points and pull the contour
inwards by 2hσ²/(h² + σ²).

Where points have standard deviations of their own (a depth camera's noise model), each
has σ² = σ_i² + (slope_std · offset_i)², with the second term for the contour's slope
between spoke and point; points of a surface are then also weighted by 1/σ².

All slices are filtered at once. Two laps close the contour. A Rauch-Tung-Striebel
smoother runs backwards, and the candidates are weighted again around the smoothed
contour, which removes the lag of weighting around a prediction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arguments import expect_positive
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.scan.candidates import Candidates

_GATE = 4.0  # candidates more deviations away than this are ignored
_SAME_SURFACE = 4.0  # gap between two surfaces, in depth deviations
_JUMP = 0.015  # deviation added per spoke whose candidates are all outside [m]
_N_REWEIGHT = 2  # rounds of weighing around the smoothed contour
_CLIFF = 2.0  # slope |dr/dz| of an end's cap or shoulder, 63°; a body's side has ≤ 1.5
_CLIFF_LENGTH = 0.005  # least length along z over which a slope is judged [m]
_END = 0.04  # cliffs farther than this from both ends are the body's own [m]


@dataclass(frozen=True)
class ContourModel:
    """Assumptions of the filter, and which points are its candidates.

    Attributes:
        depth_noise: Standard deviation σ of a point's radius, if the points have none
            of their own [m].
        slope_std: Standard deviation of the contour's slope dr/dθ [m/rad].
        slope_angle: Correlation angle of the slope [rad].
        spoke_distance: Largest distance of candidates from their spoke [m].
        slice_distance: Largest distance of points from their slice [m]; None for half
            the distance between slices, from 3 to 6 mm.
    """

    depth_noise: float = 0.003
    slope_std: float = 0.1
    slope_angle: float = 0.35
    spoke_distance: float = 0.004
    slice_distance: float | None = None

    def __post_init__(self) -> None:
        """Refuse a value that is not positive and finite, or a distance over 0.1 m."""
        for name, value in vars(self).items():
            if name.endswith("_distance"):
                if value is not None and not 0 < value < 0.1:
                    raise InputError(
                        f"{name} must be between 0 and 0.1 m, got {value:g}: it is in "
                        "metres"
                    )
            else:
                expect_positive(value, name)

    def transition(self, step: float) -> tuple[Array, Array]:
        """F and Q of one step of the angle, exact for a step of any size.

        The process dd = g dθ, dg = -g dθ/ℓ + s √(2/ℓ) dW with slope_angle ℓ and
        slope_std s, integrated over the step: s is the slope's stationary deviation
        for any number of spokes.

        Args:
            step: Angle between two spokes [rad].

        Returns:
            F and Q, shape (2, 2) each; the state is (d [m], g [m/rad]).
        """
        turned = step / self.slope_angle
        kept, lost = math.exp(-turned), -math.expm1(-turned)
        F = np.array([[1.0, self.slope_angle * lost], [0.0, kept]])
        cross = self.slope_angle * lost**2
        Q = self.slope_std**2 * np.array(
            [
                [self.slope_angle**2 * _integrated(turned), cross],
                [cross, -math.expm1(-2.0 * turned)],
            ]
        )
        return F, Q


def _integrated(x: float) -> float:
    """2x - 3 + 4e⁻ˣ - e⁻²ˣ, by its series where the sum would cancel to x³ [–]."""
    if x < 0.1:
        powers = range(3, 14)  # the next is below rounding
        return sum((4.0 - 2.0**k) / math.factorial(k) * (-x) ** k for k in powers)
    return 2.0 * x - 3.0 + 4.0 * math.exp(-x) - math.exp(-2.0 * x)


@dataclass(frozen=True)
class Contour:
    """Radii of all sections.

    Attributes:
        radius: Shape (n_theta, n_z) [m]; a prediction where not observed.
        variance: Its variance, same shape [m²].
        observed: Where candidates were accepted, same shape.
    """

    radius: Array
    variance: Array
    observed: NDArray[np.bool_]


@dataclass(frozen=True)
class _Measurement:
    """The associated measurement y, its variance, and whether it exists, (…,)."""

    y: Array
    variance: Array
    seen: NDArray[np.bool_]


def associate(
    radius: Array, predicted: Array, variance: Array, depth_noise: float | Array
) -> _Measurement:
    """Weight candidates around a prediction (eqs. 3-5, D per surface).

    Args:
        radius: Candidates sorted along the last axis, padded with inf, (…, m) [m].
        predicted: Predicted radius d̂, shape (…,) [m].
        variance: Its variance P, so that S = P + σ², shape (…,) [m²].
        depth_noise: σ, one for all or one of each candidate, shape (…, m) [m].

    Returns:
        The measurement; not ``seen`` if nothing is within the gate.
    """
    square = np.broadcast_to(np.square(depth_noise), radius.shape)
    S = variance[..., None] + square
    # Relative to the prediction: padding (inf) falls outside every gate.
    innovation = radius - predicted[..., None]
    inside = innovation**2 < _GATE**2 * S
    v = np.where(inside, innovation, 0.0)
    weight = np.exp(-0.5 * v**2 / S) * inside * _far_weight(v, inside, square) / square
    total = weight.sum(axis=-1)
    seen = total > 0
    weight /= np.where(seen, total, 1.0)[..., None]
    y = (weight * v).sum(axis=-1)
    spread = (weight * (v - y[..., None]) ** 2).sum(axis=-1)
    # Two surfaces within the gate: unsure which, beyond what noise explains.
    uncertainty = np.maximum(spread - 2.0 * (weight * square).sum(axis=-1), 0.0)
    noise = (weight**2 * square).sum(axis=-1)
    return _Measurement(predicted + y, np.where(seen, noise + uncertainty, 1.0), seen)


def _far_weight(v: Array, inside: NDArray[np.bool_], square: Array) -> Array:
    """D = (1 − (r − r_min)/(r_max − r_min))² of each candidate's surface, (…, m)."""
    n = np.maximum(inside.sum(axis=-1, keepdims=True), 1)
    mean_square = (inside * square).sum(axis=-1, keepdims=True) / n
    gap = _SAME_SURFACE * np.sqrt(mean_square)
    split = np.diff(v, axis=-1) > gap
    split &= inside[..., 1:] & inside[..., :-1]
    D = np.ones_like(v)
    rows = split.any(axis=-1)
    if not rows.any():  # one surface everywhere, the usual case: D = 1
        return D
    values, within = v[rows], inside[rows]
    label = np.zeros(values.shape, dtype=np.int64)
    label[:, 1:] = np.cumsum(split[rows], axis=-1)
    row = np.arange(len(values))[:, None] * values.shape[1]
    key = (row + label).reshape(-1)
    counted = within.reshape(-1).astype(float)
    size = np.bincount(key, counted, values.size)
    mean = np.bincount(key, counted * values.reshape(-1), values.size)
    mean = (mean / np.maximum(size, 1.0))[key].reshape(values.shape)
    low = np.where(within, mean, np.inf).min(axis=1, keepdims=True)
    # Half a gap beyond the farthest surface: its weight is small but not zero.
    high = np.where(within, mean, -np.inf).max(axis=1, keepdims=True) + gap[rows] / 2
    D[rows] = (1.0 - (mean - low) / (high - low)) ** 2
    return D


def follow(candidates: Candidates, model: ContourModel) -> Contour:
    """Contours of all sections, filtered over the angle."""
    radius, noise = candidates.radius, _noise(candidates, model)
    prior = _prior_radius(radius)
    jump = np.zeros(radius.shape[:2])
    lap = _Lap(radius, noise, prior, model, jump)
    smooth = _two_laps(lap, None)
    for _ in range(_N_REWEIGHT):
        last = associate(radius, smooth.radius, smooth.variance, noise)
        smooth = _two_laps(lap, last)
    return Contour(smooth.radius, smooth.variance, last.seen)


def without_end_cliffs(contour: Contour, z_step: float) -> Contour:
    """Contours whose first and last slices are not seen where they fall off a cliff.

    Points on the cap of a cut body, on an arm stub or across a shoulder make the radius
    jump from slice to slice. There r(θ, z) is not the body's side: every node from the
    cliff to the end of its spoke's row counts as not seen.

    Args:
        contour: Contours of all sections.
        z_step: Distance between slices [m].
    """
    seen, n_z = contour.observed, contour.radius.shape[1]
    over = min(max(1, round(_CLIFF_LENGTH / z_step)), n_z - 1)
    end = min(round(_END / z_step) + 1, n_z // 4)
    first, last = np.zeros_like(seen), np.zeros_like(seen)
    for apart in range(1, over + 1):
        low, high = slice(None, n_z - apart), slice(apart, None)
        fall = np.abs(contour.radius[:, high] - contour.radius[:, low])
        cliff = (fall > _CLIFF * over * z_step) & (seen[:, high] | seen[:, low])
        first[:, high] |= cliff
        last[:, low] |= cliff
    first[:, end:], last[:, : n_z - end] = False, False
    beyond = np.logical_or.accumulate(first[:, ::-1], axis=1)[:, ::-1]
    beyond |= np.logical_or.accumulate(last, axis=1)
    return replace(contour, observed=seen & ~beyond)


def _noise(candidates: Candidates, model: ContourModel) -> Array:
    """σ of every candidate, its point's own where points have deviations [m]."""
    if candidates.std is None or candidates.offset is None:
        return np.full_like(candidates.radius, model.depth_noise)
    return np.hypot(candidates.std, model.slope_std * candidates.offset)


def _prior_radius(radius: Array) -> Array:
    """Median candidate of each slice, or of all if a slice has none, (n_z,)."""
    by_slice = np.where(np.isfinite(radius), radius, np.nan)
    flat = by_slice.transpose(1, 0, 2).reshape(radius.shape[1], -1)
    prior = np.full(len(flat), np.nanmedian(flat))
    some = np.isfinite(flat).any(axis=1)
    prior[some] = np.nanmedian(flat[some], axis=1)
    return prior


@dataclass(frozen=True)
class _Lap:
    """Input of every lap; ``jump`` (n_theta, n_z) is filled by the first."""

    radius: Array
    noise: Array
    prior: Array
    model: ContourModel
    jump: Array


def _two_laps(lap: _Lap, given: _Measurement | None) -> Contour:
    """Two laps forward, one pass backward; the lap in the middle is kept.

    With ``given`` measurements the filter is linear; without, each spoke's candidates
    are associated around the filter's own prediction, and ``jump`` (n_theta, n_z) is
    filled with the variance [m²] added where candidates lay outside the gate: the
    contour has a step there (a shoulder) and the track must be found again.
    """
    radius, noise, model, jump = lap.radius, lap.noise, lap.model, lap.jump
    n, n_z = radius.shape[:2]
    F, Q = model.transition(2.0 * np.pi / n)
    x = np.zeros((n_z, 2))
    x[:, 0] = lap.prior
    P = np.tile(np.diag([0.05**2, model.slope_std**2]), (n_z, 1, 1))
    states, covariances = np.empty((2 * n, n_z, 2)), np.empty((2 * n, n_z, 2, 2))
    predictions, spreads = np.empty_like(states), np.empty_like(covariances)
    for step in range(2 * n):
        k = step % n
        if step:
            x, P = x @ F.T, F @ P @ F.T + Q
            P[:, 0, 0] += jump[(step - 1) % n]
        predictions[step], spreads[step] = x, P
        if given is None:
            m = associate(radius[k], x[:, 0], P[:, 0, 0], noise[k])
            missed = ~m.seen & np.isfinite(radius[k, :, 0])
            jump[k] = np.where(missed, _JUMP**2, jump[k] if step >= n else 0.0)
        else:
            m = _Measurement(given.y[k], given.variance[k], given.seen[k])
        gain = P[:, :, 0] / (P[:, 0, 0] + m.variance)[:, None] * m.seen[:, None]
        x = x + gain * (m.y - x[:, 0])[:, None]
        P = P - gain[:, :, None] * P[:, None, 0, :]
        states[step], covariances[step] = x, P
    for step in range(2 * n - 2, n // 2 - 1, -1):
        back = covariances[step] @ F.T @ np.linalg.inv(spreads[step + 1])
        x = states[step] + np.einsum("nij,nj->ni", back, x - predictions[step + 1])
        change = back @ (P - spreads[step + 1]) @ back.transpose(0, 2, 1)
        P = covariances[step] + change
        states[step], covariances[step] = x, P
    middle = slice(n // 2, n // 2 + n)
    found = np.roll(states[middle, :, 0], n // 2, axis=0)
    variance = np.roll(covariances[middle, :, 0, 0], n // 2, axis=0)
    return Contour(found, np.maximum(variance, 1e-12), np.ones((n, n_z), dtype=bool))
