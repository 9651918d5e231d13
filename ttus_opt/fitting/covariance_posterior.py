"""The error of a field whose prior's covariance is known, in closed form.

With the prior p ~ N(p̄, C) and the weighted rows D the estimate is p̄ + C Dᵀ R y, R =
(1 + D C Dᵀ)⁻¹. If the true covariances are v C of the prior and Σ of the rows' noise,
its error has, with X = N C Dᵀ and Q = X R,

    Cov[N p] = v (N C Nᵀ − Q Xᵀ − Q Qᵀ) + Q Σ Qᵀ.

C is only formed among the voxels that the rows touch. A draw is a draw of the prior
minus its estimate from its own noisy measurements. See docs/method.md, Doubt.

Source: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning
(2006), eq. 2.24.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from ttus_opt.arrays import Array, IntArray
from ttus_opt.fitting.posterior import Float32Array, Posterior, WeightedData
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.solvers.covariance import square_root
from ttus_opt.terms.structure import (
    CovarianceColumns,
    FieldCovariance,
    known_covariance,
)


@dataclass(frozen=True)
class CovariancePosterior(Posterior):
    """The error of a fit with a prior of known covariance.

    Attributes:
        prior: C.
        columns: Its columns at the n voxels that measured rows touch.
        rows: The measured rows over these voxels, times the square roots of their
            weights, (m, n).
    """

    prior: FieldCovariance = field(repr=False)
    columns: CovarianceColumns = field(repr=False)
    rows: sp.csr_array = field(repr=False)

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
        return cls(informative, measured, tag.covariance, columns, touching)

    def covariance(self, rows: sp.csr_array, height: int) -> Array:
        """Implements `Posterior`, in closed form."""
        assert self.errors is not None
        variance = self.errors.variance
        out = variance * self.prior.among_rows(rows, height)
        filled = np.diff(rows.indptr).reshape(-1, height) > 0
        for k in np.flatnonzero(filled.any(axis=1)).tolist():
            block = sp.csr_array(rows[k * height : (k + 1) * height])
            cross = self.columns.of_rows(block) @ self.rows.T
            half = self.measured.half
            gain = cross - (cross @ half.T) @ half
            noise = self.errors.roots(gain)
            out[k] += noise @ noise.T - variance * gain @ (cross + gain).T
        return out

    def draw(self, count: int, voxels: IntArray | None = None) -> Float32Array:
        """Implements `Posterior`."""
        rng, at = np.random.default_rng(0), slice(None) if voxels is None else voxels
        assert self.errors is not None
        deviation, draws = np.sqrt(self.errors.variance), []
        for _ in range(count):
            p = deviation * self.prior.draw(rng)
            samples = self.rows @ p[self.columns.voxels] + self.errors.draw(rng)
            p -= self.columns.times(self.rows.T @ self.measured.solve(samples))
            draws.append(p[at].astype(np.float32))
        return np.stack(draws)
