"""The error of a field whose prior's covariance is known, in closed form.

With the prior p ~ N(p̄, C) and the weighted rows D the estimate is p̄ + C Dᵀ R y, R =
(1 + D C Dᵀ)⁻¹. If the true covariances are v C of the prior and Σ of the rows' noise,
its error has, with X = N C Dᵀ and Q = X R,

    Cov[N p] = v (N C Nᵀ − Q Xᵀ − Q Qᵀ) + Q Σ Qᵀ.

C is only formed among the voxels that the rows touch. A draw is a draw of the prior
minus its estimate from its own noisy measurements.

Where the mean has unknown multiples β of fields H, they add the covariance
v T Tᵀ, T = (N − Q D) H (1 + HᵀDᵀ R D H)^(−1/2): universal kriging. See
docs/method/identification.md, Uncertainty.

Source: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning
(2006), eqs. 2.24 and 2.42.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.fitting.uncertainty.posterior import Float32Array, Posterior, WeightedData
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.terms.structure import (
    CovarianceColumns,
    FieldCovariance,
    known_covariance,
)
from ttus_opt.solvers.covariance import square_root

#: Rows whose covariance with all measured voxels is formed at once, and rows that are
#: corrected by all measurements at once: one pass over these costs more than the sums
AT_ONCE, BATCH = 6, 192


@dataclass(frozen=True)
class CovariancePosterior(Posterior):
    """The error of a fit with a prior of known covariance.

    Attributes:
        prior: C.
        columns: Its columns at the n voxels that measured rows touch.
        rows: The measured rows over these voxels, times the square roots of their
            weights, (m, n).
        drift: H (1 + HᵀDᵀ R D H)^(−1/2), shape (V, k).
        drift_rows: D times it, shape (m, k).
    """

    prior: FieldCovariance = field(repr=False)
    columns: CovarianceColumns = field(repr=False)
    rows: sp.csr_array = field(repr=False)
    drift: Array = field(repr=False)
    drift_rows: Array = field(repr=False)

    @classmethod
    def of(cls, prior: ProgramTerm, terms: list[ProgramTerm]) -> CovariancePosterior:
        """Form the covariance of the measured rows.

        Args:
            prior: The term of known covariance, of a program of one field.
            terms: The measured terms.
        """
        tag = known_covariance(prior.tags)
        assert tag is not None
        roots = [np.sqrt(t.weight / prior.weight) for t in terms]
        scaled = [t.matrix * r for t, r in zip(terms, roots, strict=True)]
        rows = sp.csr_array(sp.vstack(scaled, format="csr"))
        informative = np.diff(rows.indptr) > 0
        rows = rows[informative]
        target = np.concatenate(
            [t.target * r for t, r in zip(terms, roots, strict=True)]
        )
        mean = tag.covariance.times(prior.matrix.T @ prior.target)
        columns = tag.covariance.columns(np.unique(rows.indices).astype(np.int64))
        touching = sp.csr_array(rows.tocsc()[:, columns.voxels])
        weighted = np.ascontiguousarray((touching @ square_root(columns.among)).T)
        measured = WeightedData.of(weighted, target[informative] - rows @ mean)
        drift = np.zeros((rows.shape[1], 0))
        if tag.mean is not None:
            seen = rows @ tag.mean.drift
            told = seen.T @ np.stack([measured.solve(h) for h in seen.T], axis=1)
            told[np.diag_indices_from(told)] += 1.0
            drift = tag.mean.drift @ np.linalg.inv(np.linalg.cholesky(told)).T
        own = tag.covariance, columns, touching, drift, rows @ drift
        return cls(informative, measured, *own)

    def covariance(self, rows: sp.csr_array, height: int) -> Array:
        """Implements `Posterior`, in closed form."""
        assert self.errors is not None
        variance = self.errors.variance
        out = variance * self.prior.among_rows(rows, height)
        filled = np.diff(rows.indptr).reshape(-1, height) > 0
        (blocks,) = np.nonzero(filled.any(axis=1))
        step = max(BATCH // height, 1)
        for some in (blocks[i : i + step] for i in range(0, len(blocks), step)):
            at = (some[:, None] * height + np.arange(height)).ravel()
            cross = self._cross(sp.csr_array(rows[at]))
            half = self.measured.half
            gain = cross - (cross @ half.T) @ half
            mean = rows[at] @ self.drift - gain @ self.drift_rows
            mean, gain, total, noise = (
                part.reshape(len(some), height, -1)
                for part in (mean, gain, cross + gain, self.errors.roots(gain))
            )
            own = mean @ mean.transpose(0, 2, 1) - gain @ total.transpose(0, 2, 1)
            out[some] += noise @ noise.transpose(0, 2, 1) + variance * own
        return out

    def _cross(self, rows: sp.csr_array) -> Array:
        """N C Dᵀ, few rows at a time: each has a column for every measured voxel."""
        few = (rows[i : i + AT_ONCE] for i in range(0, rows.shape[0], AT_ONCE))
        return np.concatenate([self.columns.of_rows(r) @ self.rows.T for r in few])

    def draw(self, count: int, voxels: IntArray | None = None) -> Float32Array:
        """Implements `Posterior`."""
        rng, at = np.random.default_rng(0), slice(None) if voxels is None else voxels
        assert self.errors is not None
        deviation, draws = np.sqrt(self.errors.variance), []
        for _ in range(count):
            mean = self.drift @ rng.standard_normal(self.drift.shape[1])
            p = deviation * (self.prior.draw(rng) + mean)
            samples = self.rows @ p[self.columns.voxels] + self.errors.draw(rng)
            p -= self.columns.times(self.rows.T @ self.measured.solve(samples))
            draws.append(p[at].astype(np.float32))
        return np.stack(draws)
