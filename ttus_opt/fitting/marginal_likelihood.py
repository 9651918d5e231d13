"""Marginal likelihood of measured wrenches with errors correlated along a press.

A reduced basis of response fields has the images K, so that the prior's covariance of
the rows is KᵀK (docs/method.md, "Many weights"). The error of a row is sensor noise,
new in every frame, plus what the model cannot represent, which changes slowly along a
press: an Ornstein-Uhlenbeck process of correlation time T, independent between presses.
Taking frames as independent would give weights a thousand times too large. A row of
weight λ has the variance σ²/λ; the part w/(1 + w) of it is sensor noise. With R the
errors' correlation over the frames,

    R(i, j) = (exp(-|tᵢ - tⱼ|/T) + w δᵢⱼ)/(1 + w)    in one press, otherwise 0,

and A √λ the filter that whitens the errors (the innovations of a Kalman filter, R. H.
Jones, Technometrics 22, 1980), B the whitened images, t the whitened targets, s the
scale of the boundary values and u the whitened rows of the Laplace field for s = 1,

    log p = -½ (m log(2π J/m) + log det(1 + B Bᵀ) + log det(R/λ) + m),
    J = (t - s u)ᵀ(1 + BᵀB)⁻¹(t - s u),    s of generalised least squares.

(Rasmussen and Williams, 2006, eq. 2.30.) w is one number per measured term.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ttus_opt.arrays import Array, IntArray


@dataclass(frozen=True)
class SeriesNoise:
    """Correlation of the errors of measured rows.

    Attributes:
        correlation_time: T of the part that changes slowly; 0 for none [s].
        sensor: w, variance of sensor noise over that part's, shape (terms,) [–].
    """

    correlation_time: float
    sensor: Array

    def correlation(self, time: Array, press: IntArray, term: int) -> Array:
        """R of one term's errors, shape (frames, frames).

        Args:
            time: Of the frames [s].
            press: Press of every frame [–].
            term: Number of the term [–].
        """
        apart = np.abs(time[:, None] - time)
        with np.errstate(divide="ignore", invalid="ignore"):
            slow = np.exp(-apart / self.correlation_time)
        slow = np.where(press[:, None] == press, slow, 0.0)
        own = float(self.sensor[term])
        slow[np.diag_indices_from(slow)] = 1.0 + own
        return np.asarray(slow / (1.0 + own))


#: Share of their own squares by which u and t are kept from being singular [–]
HELD = 1e-6


@dataclass(frozen=True)
class Evidence:
    """Evidence of a set of hyperparameters.

    Attributes:
        log_density: Log density of the measurements at the most likely σ² and s [–].
        scale: s [–].
        scale_error: Its standard error [–].
        variance: σ², of a row of weight 1 [N²].
    """

    log_density: float
    scale: float
    scale_error: float
    variance: float


@dataclass(frozen=True)
class MeasuredSeries:
    """Measured rows by term, frame and component, over a reduced basis.

    Part of the rows may be multiplied by a coefficient, such as drag by μ.

    Attributes:
        terms: Names of the measured terms.
        images: K, shape (k, terms, frames, 3).
        base: Values of the Laplace field, shape (terms, frames, 3) [N].
        target: Measurements, shape (terms, frames, 3) [N].
        time: Times of the frames [s].
        press: Press of every frame, shape (frames,) [–].
        place: Place of every frame, shape (frames,) [–].
        slope: Images and base of the part with the coefficient; None without one.
    """

    terms: tuple[str, ...]
    images: Array = field(repr=False)
    base: Array = field(repr=False)
    target: Array = field(repr=False)
    time: Array = field(repr=False)
    press: IntArray = field(repr=False)
    place: IntArray = field(repr=False)
    slope: tuple[Array, Array] | None = field(default=None, repr=False)

    @property
    def frames(self) -> int:
        """Number of frames [–]."""
        return len(self.time)

    def at(self, coefficient: float) -> MeasuredSeries:
        """The series at a value of its coefficient."""
        if self.slope is None:
            return self
        images, base = self.slope
        return replace(
            self,
            images=self.images + coefficient * images,
            base=self.base + coefficient * base,
            slope=None,
        )

    def thinned(self, every: int) -> MeasuredSeries:
        """Every n-th frame of every press."""
        if every <= 1:
            return self
        starts = np.flatnonzero(np.diff(self.press, prepend=self.press[:1] - 1))
        place = np.arange(self.frames) - np.repeat(
            starts, np.diff(starts, append=self.frames)
        )
        kept = place % every == 0
        slope = None
        if self.slope is not None:
            slope = self.slope[0][:, :, kept], self.slope[1][:, kept]
        return replace(
            self,
            images=self.images[:, :, kept],
            base=self.base[:, kept],
            target=self.target[:, kept],
            time=self.time[kept],
            press=self.press[kept],
            place=self.place[kept],
            slope=slope,
        )

    def evidence(
        self, weights: Array, noise: SeriesNoise, scale: float | None = None
    ) -> Evidence:
        """The marginal likelihood of rows without a coefficient.

        Args:
            weights: λ by term, shape (terms,) [–].
            noise: Correlation of the errors.
            scale: s; None for the most likely.
        """
        assert self.slope is None
        n = len(self.images)
        both = np.stack([self.base, self.target])
        columns, determinant = self._white(
            np.concatenate([self.images, both]), np.asarray(weights), noise
        )
        gram = columns @ columns.T
        size = np.diag(gram)[n:]
        # so that u = 0 has a factor as well; taken off again
        held = np.where(size > 0.0, HELD * size, 1.0)
        gram[np.diag_indices(n + 2)] += np.concatenate([np.ones(n), held])
        # its last block is the Cholesky factor of what the prior leaves of u and t
        lower = np.linalg.cholesky(gram)
        rest = lower[n:, n:] @ lower[n:, n:].T - np.diag(held)
        uu, ut, tt = max(float(rest[0, 0]), 0.0), float(rest[0, 1]), float(rest[1, 1])
        if scale is None:
            scale = float(ut / uu) if uu > 0.0 else 1.0
        m = columns.shape[1]
        square = max(float(tt - 2.0 * scale * ut + scale**2 * uu), 1e-300)
        determinant += float(np.log(np.diag(lower)[:n]).sum())
        density = -0.5 * m * (np.log(2.0 * np.pi * square / m) + 1.0) - determinant
        error = float(np.sqrt(square / m / uu)) if uu > 0.0 else np.inf
        return Evidence(float(density), scale, error, square / m)

    def _white(
        self, values: Array, weights: Array, noise: SeriesNoise
    ) -> tuple[Array, float]:
        """Rows times A √λ, (k, terms, frames, 3) to (k, rows), and -log det of A √λ.

        The innovations of a Kalman filter, whose state is the slow part of the errors:
        without a factorisation, so that BLAS threads do not wait for each other.
        """
        rows = np.ascontiguousarray(values.transpose(2, 1, 0, 3))
        rows *= np.sqrt(weights)[:, None, None]
        slow, sensor = 1.0 / (1.0 + noise.sensor), noise.sensor / (1.0 + noise.sensor)
        step = np.abs(np.diff(self.time, prepend=self.time[:1]))
        begins = np.diff(self.press, prepend=self.press[:1] - 1) != 0
        with np.errstate(divide="ignore", invalid="ignore"):
            memory = np.where(begins, 0.0, np.exp(-step / noise.correlation_time))
        state, spread = np.zeros_like(rows[0]), slow
        determinant = -1.5 * self.frames * float(np.log(weights).sum())
        for row, phi in zip(rows, memory, strict=True):
            state *= phi
            spread = phi**2 * spread + (1.0 - phi**2) * slow
            whole = spread + sensor
            row -= state
            state += (spread / whole)[:, None, None] * row
            row /= np.sqrt(whole)[:, None, None]
            spread = spread * sensor / whole
            determinant += 1.5 * float(np.log(whole).sum())
        return rows.transpose(2, 1, 0, 3).reshape(len(values), -1), determinant
