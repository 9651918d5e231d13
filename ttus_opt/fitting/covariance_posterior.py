"""The posterior of a field whose prior's covariance is known, in closed form.

With the prior p ~ N(p̄, C) and the weighted rows D,

    Cov[N p] = N C Nᵀ − N C Dᵀ (1 + D C Dᵀ)⁻¹ D C Nᵀ,

where C is only formed among the voxels that the rows touch. A draw is one of the prior,
corrected by what its own noisy measurements say of it. See docs/method.md, Doubt.

Source: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning
(2006), eq. 2.24.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from ttus_opt.arrays import Array, IntArray, Mask
from ttus_opt.fitting.posterior import MeasuredRows, Single
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
    """The Gaussian of a problem, with σ² = 1.

    Attributes:
        covariance_of: C.
        columns: Its columns at the voxels that measured rows touch, n of them.
        rows: The measured rows over these voxels, times their weights' roots, (m, n).
        told: Rows of the problem that say something of the field, shape (M,).
        measured: What they say.
    """

    prior: FieldCovariance = field(repr=False)
    columns: CovarianceColumns = field(repr=False)
    rows: sp.csr_array = field(repr=False)
    told: Mask = field(repr=False)
    measured: MeasuredRows = field(repr=False)

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

    def covariance(self, rows: sp.csr_array, height: int) -> Array:
        """Of blocks of rows, in closed form."""
        out = self.prior.among_rows(rows, height)
        told = np.diff(rows.indptr).reshape(-1, height) > 0
        for k in np.flatnonzero(told.any(axis=1)).tolist():
            block = sp.csr_array(rows[k * height : (k + 1) * height])
            cross = self.columns.of_rows(block) @ self.rows.T
            known = cross @ self.measured.half.T
            out[k] += known @ known.T - cross @ cross.T
        return out

    def draw(self, count: int, voxels: IntArray | None = None) -> Single:
        """Draws of the field around its mean, shape (count, n).

        Args:
            count: How many [–].
            voxels: Where, shape (n,); None for everywhere.
        """
        rng, at = np.random.default_rng(0), slice(None) if voxels is None else voxels
        draws = []
        for _ in range(count):
            p = self.prior.draw(rng)
            said = self.rows @ p[self.columns.voxels]
            said += rng.standard_normal(len(said))
            p -= self.columns.times(self.rows.T @ self.measured.solve(said))
            draws.append(p[at].astype(np.float32))
        return np.stack(draws)
