"""The error of a field whose prior's covariance is known, in closed form.

With the prior p ~ N(p̄, C) and the weighted rows D the estimate is p̄ + C Dᵀ R y, R =
(1 + D C Dᵀ)⁻¹. Where the prior's covariance is v C and that of the rows' noise Σ, with
X = N C Dᵀ and Q = X R its error has

    Cov[N p] = v (N C Nᵀ − Q Xᵀ − Q Qᵀ) + Q Σ Qᵀ,

where C is only formed among the voxels that the rows touch. A draw is one of the prior,
corrected by what its own noisy measurements say of it. See docs/method.md, Doubt.

Source: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning
(2006), eq. 2.24.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp

from ttus_opt.arrays import Array, IntArray, Mask
from ttus_opt.fitting.posterior import MeasuredRows, Single
from ttus_opt.fitting.wrench_noise import ErrorModel
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.program import Program
from ttus_opt.solvers.covariance import square_root
from ttus_opt.terms.structure import (
    CovarianceColumns,
    FieldCovariance,
    known_covariance,
)


@dataclass(frozen=True)
class CovariancePosterior:
    """The error of a fit.

    Attributes:
        prior: C.
        columns: Its columns at the voxels that measured rows touch, n of them.
        rows: The measured rows over these voxels, times their weights' roots, (m, n).
        told: Rows of the problem that say something of the field, shape (M,).
        measured: What they say.
        errors: The prior's variance and the rows' noise; None before they are known.
    """

    prior: FieldCovariance = field(repr=False)
    columns: CovarianceColumns = field(repr=False)
    rows: sp.csr_array = field(repr=False)
    told: Mask = field(repr=False)
    measured: MeasuredRows = field(repr=False)
    errors: ErrorModel | None = field(default=None, repr=False)

    @classmethod
    def of(
        cls, program: Program, prior: ProgramTerm, terms: list[ProgramTerm]
    ) -> CovariancePosterior:
        """Form the covariance of the measured rows.

        Args:
            program: Of one field.
            prior: Its term with a known covariance.
            terms: The measured ones.
        """
        tag = known_covariance(prior.tags)
        assert tag is not None
        roots = [np.sqrt(t.weight / prior.weight) for t in terms]
        scaled = [t.matrix * r for t, r in zip(terms, roots, strict=True)]
        rows = sp.csr_array(sp.vstack(scaled, format="csr"))
        told = np.diff(rows.indptr) > 0
        rows = rows[told]
        target = np.concatenate(
            [t.target * r for t, r in zip(terms, roots, strict=True)]
        )
        mean = tag.covariance.times(prior.matrix.T @ prior.target)
        columns = tag.covariance.columns(np.unique(rows.indices).astype(np.int64))
        touching = sp.csr_array(rows.tocsc()[:, columns.voxels])
        weighted = np.ascontiguousarray((touching @ square_root(columns.among)).T)
        measured = MeasuredRows.of(weighted, target[told] - rows @ mean)
        return cls(tag.covariance, columns, touching, told, measured)

    def with_errors(self, errors: ErrorModel) -> CovariancePosterior:
        """The same with the prior's variance and the rows' noise as they are."""
        return replace(self, errors=errors)

    def covariance(self, rows: sp.csr_array, height: int) -> Array:
        """Of blocks of rows, in closed form."""
        assert self.errors is not None
        variance = self.errors.variance
        out = variance * self.prior.among_rows(rows, height)
        told = np.diff(rows.indptr).reshape(-1, height) > 0
        for k in np.flatnonzero(told.any(axis=1)).tolist():
            block = sp.csr_array(rows[k * height : (k + 1) * height])
            cross = self.columns.of_rows(block) @ self.rows.T
            half = self.measured.half
            gain = cross - (cross @ half.T) @ half
            noise = self.errors.roots(gain)
            out[k] += noise @ noise.T - variance * gain @ (cross + gain).T
        return out

    def draw(self, count: int, voxels: IntArray | None = None) -> Single:
        """Draws of the fit's error, shape (count, n).

        Args:
            count: How many [–].
            voxels: Where, shape (n,); None for everywhere.
        """
        rng, at = np.random.default_rng(0), slice(None) if voxels is None else voxels
        assert self.errors is not None
        deviation, draws = np.sqrt(self.errors.variance), []
        for _ in range(count):
            p = deviation * self.prior.draw(rng)
            said = self.rows @ p[self.columns.voxels] + self.errors.draw(rng)
            p -= self.columns.times(self.rows.T @ self.measured.solve(said))
            draws.append(p[at].astype(np.float32))
        return np.stack(draws)
