"""Marginal likelihood of measured wrenches with errors correlated along a press.

A reduced basis of response fields has the images K, so that the prior's covariance of
the rows is KᵀK (docs/method.md, "Many weights"). The error of a frame is sensor noise
plus what the model cannot represent, which changes slowly along a press. Taking frames
as independent would give weights a thousand times too large. Every component of the
error is therefore an Ornstein-Uhlenbeck process of variance σ²/λ and correlation time
T, independent between presses:

    e(t) = φ e(t - δ) + √(1 - φ²) n,    φ = exp(-δ/T).

A is this recursion solved for n: bidiagonal, so that A √λ (f - N p) is white. With B
the whitened images, t the whitened targets, s the scale of the boundary values and u
the whitened rows of the Laplace field for s = 1,

    log p = -½ (m log(2π J/m) + log det(1 + B Bᵀ) - 2 log det(A √λ) + m),
    J = (t - s u)ᵀ(1 + BᵀB)⁻¹(t - s u),    s of generalised least squares.

(Rasmussen and Williams, 2006, eq. 2.30; A after R. H. Jones, Technometrics 22, 1980).

A formulation assumes independent frames. Under the correlated errors above, its
estimate with the weights c λ has the mean squared error at the measured rows

    Σᵢ gᵢ (1 + c² rᵢ)/(1 + c gᵢ)²,    B₀ B₀ᵀ = V diag(g) Vᵀ,    r = diag(Vᵀ B₀ R B₀ᵀ V),

with B₀ the images times √λ and R = (AᵀA)⁻¹. The share c that minimises it is used.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import scipy.optimize

from ttus_opt.arrays import Array, IntArray

#: Least share c of the weights [–]
LEAST_SHARE = 1e-4


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
        slope: Images and base of the part with the coefficient; None without one.
    """

    terms: tuple[str, ...]
    images: Array = field(repr=False)
    base: Array = field(repr=False)
    target: Array = field(repr=False)
    time: Array = field(repr=False)
    press: IntArray = field(repr=False)
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
            slope=slope,
        )

    def memory(self, correlation_time: float) -> Array:
        """φ between a frame and the one before; 0 where a press begins, (frames,)."""
        step = np.diff(self.time, prepend=self.time[:1])
        begins = np.diff(self.press, prepend=self.press[:1] - 1) != 0
        with np.errstate(divide="ignore", invalid="ignore"):
            phi = np.exp(-np.abs(step) / correlation_time)
        return np.where(begins, 0.0, phi)

    def independent_share(self, weights: Array, correlation_time: float) -> float:
        """Share c of the weights for a fit that assumes independent frames.

        Args:
            weights: λ by term, shape (terms,) [–].
            correlation_time: T [s].
        """
        assert self.slope is None
        root = np.sqrt(np.asarray(weights, dtype=np.float64))[:, None, None]
        B = root * self.images
        spread = _coloured(B, self.memory(correlation_time))
        flat = B.reshape(len(B), -1)
        gain, turn = np.linalg.eigh(flat @ flat.T)
        noise = ((turn.T @ spread.reshape(len(B), -1)) ** 2).sum(axis=1)
        gain = np.maximum(gain, 0.0)

        def error(logarithm: float) -> float:
            share = np.exp(logarithm)
            return float(
                (gain * (1.0 + share**2 * noise) / (1.0 + share * gain) ** 2).sum()
            )

        lowest = float(np.log(LEAST_SHARE))
        found = scipy.optimize.minimize_scalar(
            error, bounds=(lowest, 0.0), method="bounded"
        )
        return float(np.exp(found.x))

    def evidence(
        self, weights: Array, correlation_time: float, scale: float | None = None
    ) -> Evidence:
        """The marginal likelihood of rows without a coefficient.

        Args:
            weights: λ by term, shape (terms,) [–].
            correlation_time: T; 0 for independent frames [s].
            scale: s; None for the most likely.
        """
        assert self.slope is None
        phi = self.memory(correlation_time)
        root = np.sqrt(np.asarray(weights, dtype=np.float64))[:, None, None]
        white = [
            _whitened(root * values, phi)
            for values in (self.images, self.base[None], self.target[None])
        ]
        B, (u,), (t,) = white
        gram = B @ B.T
        gram[np.diag_indices_from(gram)] += 1.0
        lower = np.linalg.cholesky(gram)
        both = np.stack([u, t], axis=1)
        # numpy's solver, as numpy's and scipy's threads would wait for each other
        half = np.linalg.solve(lower, B @ both)
        (uu, ut), (_, tt) = both.T @ both - half.T @ half
        if scale is None:
            scale = float(ut / uu) if uu > 0.0 else 1.0
        m = len(t)
        square = max(float(tt - 2.0 * scale * ut + scale**2 * uu), 1e-300)
        per_row = -0.5 * 3.0 * len(self.terms) * float(np.log1p(-(phi**2)).sum())
        per_row += 1.5 * self.frames * float(np.log(weights).sum())
        determinant = float(np.log(np.diag(lower)).sum()) - per_row
        density = -0.5 * m * (np.log(2.0 * np.pi * square / m) + 1.0) - determinant
        error = float(np.sqrt(square / m / uu)) if uu > 0.0 else np.inf
        return Evidence(float(density), scale, error, square / m)


def _whitened(values: Array, phi: Array) -> Array:
    """Rows times A, flattened: (..., terms, frames, 3) to (..., rows)."""
    out = values.copy()
    before = phi[1:, None]
    out[..., 1:, :] -= before * values[..., :-1, :]
    out /= np.sqrt(1.0 - phi**2)[:, None]
    return np.asarray(out.reshape(*values.shape[:-3], -1))


def _coloured(values: Array, phi: Array) -> Array:
    """Rows times A⁻¹, (k, terms, frames, 3): their products are those with R."""
    out, root = values.copy(), np.sqrt(1.0 - phi**2)
    for frame in range(len(phi) - 1, -1, -1):
        if frame + 1 < len(phi) and phi[frame + 1] > 0.0:
            carried = phi[frame + 1] / root[frame + 1]
            out[..., frame, :] += carried * out[..., frame + 1, :]
        out[..., frame, :] *= root[frame]
    return out
