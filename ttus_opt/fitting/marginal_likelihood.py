"""Marginal likelihood of measured wrenches with errors correlated along a press.

A reduced basis of response fields has the images K, so that the prior's covariance of
the rows is KᵀK (docs/method.md, "Many weights"). Their errors are correlated along a
press (`series_noise`): taking frames as independent would give weights a thousand times
too large. A row of weight λ has the variance σ²/λ. With R the errors' correlation over
the frames, A = R^(-1/2) what whitens them, B the whitened images times √λ, t the
whitened targets, s the scale of the boundary values and u the whitened rows of the
Laplace field for s = 1,

    log p = -½ (m log(2π J/m) + log det(1 + B Bᵀ) + log det(R/λ) + m),
    J = (t - s u)ᵀ(1 + BᵀB)⁻¹(t - s u),    s of generalised least squares

(Rasmussen and Williams, 2006, eq. 2.30). With c = (1 + BBᵀ)⁻¹B(t - s u), the residual
ρ = t - s u - Bᵀc and the matrix Q = (m/J) ρρᵀ - 1 + Bᵀ(1 + BBᵀ)⁻¹B, it changes with R,
λ and the rows by (ibid., eq. 5.9)

    d log p = ½ tr(Q A dR Aᵀ) - ½ tr Q d log λ
              + (m/J) ρᵀ(s du + dBᵀc) - tr((1 + BBᵀ)⁻¹B dBᵀ).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import scipy.linalg

from ttus_opt.arrays import Array, IntArray
from ttus_opt.fitting.series_noise import PressTimes, SeriesNoise, Whitening


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
class EvidenceSlope:
    """Derivatives of the log density.

    Attributes:
        log_weights: By the logarithms of λ, shape (terms,) [–].
        sensor: By w, shape (terms,) [–].
        correlation_time: By T [1/s].
        coefficient: By the coefficient of the rows [–].
    """

    log_weights: Array
    sensor: Array
    correlation_time: float
    coefficient: float


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

    def condensed(self, weights: Array, missing: float) -> MeasuredSeries:
        """The series over fewer combinations of its images.

        Args:
            weights: The largest λ by term that will be used, shape (terms,) [–].
            missing: Trace of the rows' covariance, in units of their noise, that they
                may miss; with a coefficient, of both parts' [–].
        """
        parts = [self.images] if self.slope is None else [self.images, self.slope[0]]
        gram = np.zeros((len(self.images), len(self.images)))
        for images in parts:
            columns = images * np.sqrt(weights)[:, None, None]
            columns = columns.reshape(len(images), -1)
            gram += columns @ columns.T
        energy, turn = np.linalg.eigh(gram)
        few = min(int(np.searchsorted(np.cumsum(energy), missing)), len(gram) - 1)
        kept = turn[:, few:].T

        def turned(images: Array) -> Array:
            return (kept @ images.reshape(len(images), -1)).reshape(
                -1, *images.shape[1:]
            )

        slope = None if self.slope is None else (turned(self.slope[0]), self.slope[1])
        return replace(self, images=turned(self.images), slope=slope)

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
        return MarginalLikelihood(self).evidence(weights, noise, scale=scale)


class MarginalLikelihood:
    """The evidence of one series and its derivatives, for many hyperparameters.

    Frames are whitened press by press, which needs small matrices only.
    """

    def __init__(self, series: MeasuredSeries) -> None:
        """Arrange the rows.

        Args:
            series: Its presses are consecutive.
        """
        self._count = len(series.images)
        self._presses = PressTimes.of(series.time, series.press)
        self._rows = _columns(series.images, series.base, series.target)
        self._by_coefficient = None
        if series.slope is not None:
            nothing = np.zeros_like(series.target)
            self._by_coefficient = _columns(*series.slope, nothing)

    def evidence(
        self,
        weights: Array,
        noise: SeriesNoise,
        coefficient: float = 0.0,
        scale: float | None = None,
    ) -> Evidence:
        """The marginal likelihood.

        Args:
            weights: λ by term, shape (terms,) [–].
            noise: Correlation of the errors.
            coefficient: Of the rows.
            scale: s; None for the most likely.
        """
        return self._at(weights, noise, coefficient, scale).evidence

    def with_slope(
        self,
        weights: Array,
        noise: SeriesNoise,
        coefficient: float = 0.0,
        scale: float | None = None,
    ) -> tuple[Evidence, EvidenceSlope]:
        """The same and its derivatives; arguments as `evidence`."""
        found = self._at(weights, noise, coefficient, scale)
        shape = self._rows.shape
        half = (found.images @ found.inverse.T).reshape(*shape[:3], self._count)
        rest, share = found.rest.reshape(shape[:3]), found.precision
        by_weight, by_sensor, by_time = np.zeros(shape[0]), np.zeros(shape[0]), 0.0
        for whitening in found.whitening:
            for t, one in enumerate(whitening):
                A, y = one.filter, half[t, one.frames].reshape(len(one.filter), -1)
                own = rest[t, one.frames]
                Q = y @ y.T + share * (own @ own.T) - 3.0 * np.eye(len(A))
                turned = A.T @ Q @ A
                by_weight[t] -= 0.5 * float(np.trace(Q))
                by_sensor[t] += 0.5 * float((turned * one.by_sensor).sum())
                by_time += 0.5 * float((turned * one.by_time).sum())
        by_coefficient = 0.0
        if self._by_coefficient is not None:
            moved = self._white(self._by_coefficient, weights, found.whitening)
            images, base = moved[:, :-2], moved[:, -2]
            by_coefficient = share * float(
                found.rest @ (found.scale * base + images @ found.response)
            )
            both = found.inverse @ (found.images.T @ images)
            by_coefficient -= float((found.inverse * both).sum())
        slope = EvidenceSlope(by_weight, by_sensor, by_time, by_coefficient)
        return found.evidence, slope

    def _at(
        self,
        weights: Array,
        noise: SeriesNoise,
        coefficient: float,
        scale: float | None,
    ) -> _Solved:
        rows, k = self._rows, self._count
        if self._by_coefficient is not None:
            rows = rows + coefficient * self._by_coefficient
        whitening = [noise.whitening(press) for press in self._presses]
        columns = self._white(rows, weights, whitening)
        B, both = columns[:, :k], columns[:, k:]
        gram = B.T @ B
        gram[np.diag_indices(k)] += 1.0
        inverse, _ = scipy.linalg.lapack.dtrtri(np.linalg.cholesky(gram), lower=1)
        c = inverse.T @ (inverse @ (B.T @ both))
        rest = both - B @ c
        (uu, ut), (_, tt) = rest.T @ rest + c.T @ c
        m = len(columns)
        if scale is None:
            scale = float(ut / uu) if uu > 0.0 else 1.0
        square = max(float(tt - 2.0 * scale * ut + scale**2 * uu), 1e-300)
        determinant = 1.5 * self._rows.shape[1] * float(np.log(weights).sum())
        for press in whitening:
            for one in press:
                determinant += 3.0 * float(np.log(np.diag(one.filter)).sum())
        determinant += float(np.log(np.diag(inverse)).sum())
        density = determinant - 0.5 * m * (np.log(2.0 * np.pi * square / m) + 1.0)
        error = float(np.sqrt(square / m / uu)) if uu > 0.0 else np.inf
        evidence = Evidence(float(density), scale, error, square / m)
        mix = np.array([-scale, 1.0])
        return _Solved(evidence, whitening, B, inverse, c @ mix, rest @ mix)

    def _white(
        self, rows: Array, weights: Array, whitening: list[list[Whitening]]
    ) -> Array:
        """Rows times A √λ, (terms, frames, 3, q) to (rows, q)."""
        out = np.empty_like(rows)
        for press in whitening:
            for t, one in enumerate(press):
                n, frames = len(one.filter), one.frames
                A = np.sqrt(weights[t]) * one.filter
                np.matmul(
                    A, rows[t, frames].reshape(n, -1), out=out[t, frames].reshape(n, -1)
                )
        return out.reshape(-1, rows.shape[-1])


@dataclass(frozen=True)
class _Solved:
    """One evaluation.

    Attributes:
        evidence: What it found.
        whitening: By press and term.
        images: B, transposed, shape (m, k).
        inverse: Of the Cholesky factor of 1 + BBᵀ, shape (k, k).
        response: c, shape (k,).
        rest: ρ, shape (m,).
    """

    evidence: Evidence
    whitening: list[list[Whitening]]
    images: Array
    inverse: Array
    response: Array
    rest: Array

    @property
    def scale(self) -> float:
        """Scale s of the boundary values [–]."""
        return self.evidence.scale

    @property
    def precision(self) -> float:
        """m/J [1/N²]."""
        return 1.0 / self.evidence.variance


def _columns(images: Array, base: Array, target: Array) -> Array:
    """Images, Laplace field and targets as columns, shape (terms, frames, 3, k + 2)."""
    every = np.concatenate([images, base[None], target[None]])
    return np.ascontiguousarray(np.moveaxis(every, 0, -1))
