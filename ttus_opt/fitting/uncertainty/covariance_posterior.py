"""The error of a field whose prior's covariance is known, in closed form.

C is only formed among the voxels that the rows touch. Where the mean has unknown
multiples β of fields H, they add the covariance v T Tᵀ, T = (N − Q D) H (1 + HᵀDᵀ S⁻¹ D
H)^(−1/2): universal kriging.

Such a mean is a profile φ that places of a body have in common up to factors, and
factors are what is alike: p = φ e^g rather than φ (1 + g), which a linear fit needs.
With φ e^g ≈ p̂ + (p̂/φ) φ (g − ĝ) about the fit p̂, the error of p is p̂/φ times that
of a fit whose noise is divided by p̂/φ: a stiff place is uncertain by more newtons than
a soft one.

Source: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning
(2006), eqs. 2.24 and 2.42.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.fitting.uncertainty.posterior import Float32Array, Posterior
from ttus_opt.gaussian.conditioned import conditioned
from ttus_opt.gaussian.prior import Columns, square_root
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.terms.structure import known_covariance

#: Rows whose covariance with all measured voxels is formed at once
AT_ONCE = 6

#: Least and largest p̂/φ: a linear fit may leave the range of a factor [–]
FACTORS = 0.3, 3.0


@dataclass(frozen=True)
class CovariancePosterior(Posterior):
    """The error of a fit with a prior of known covariance.

    Attributes:
        columns: Columns of C at the n voxels that measured rows touch.
        touching: D over these voxels, shape (rows, n).
        drift: H (1 + HᵀDᵀ S⁻¹ D H)^(−1/2), shape (V, k).
        drift_rows: D times it, shape (rows, k).
        factor: p̂/φ, within `FACTORS`; 1 of a prior without an uncertain mean, (V,).
        row_factor: Its mean over the voxels of every row of D, shape (rows,).
    """

    columns: Columns = field(repr=False)
    touching: sp.csr_array = field(repr=False)
    drift: Array = field(repr=False)
    drift_rows: Array = field(repr=False)
    factor: Array = field(repr=False)
    row_factor: Array = field(repr=False)

    @classmethod
    def of(
        cls, prior: ProgramTerm, terms: list[ProgramTerm], values: Array
    ) -> CovariancePosterior:
        """Form the covariance of the measured rows.

        Args:
            prior: The term of known covariance, of a program of one field.
            terms: The measured terms.
            values: p̂, shape (V,).
        """
        tag = known_covariance(prior.tags)
        assert tag is not None
        roots = [np.sqrt(t.weight / prior.weight) for t in terms]
        scaled = [t.matrix * r for t, r in zip(terms, roots, strict=True)]
        rows = sp.csr_array(sp.vstack(scaled, format="csr"))
        told = np.diff(rows.indptr) > 0
        rows = rows[told]
        targets = [t.target * r for t, r in zip(terms, roots, strict=True)]
        mean = tag.covariance.times(prior.matrix.T @ prior.target)
        columns = tag.covariance.columns(np.unique(rows.indices).astype(np.int64))
        touching = sp.csr_array(rows.tocsc()[:, columns.voxels])
        images = np.ascontiguousarray((touching @ square_root(columns.among)).T)
        measured = conditioned(images, np.concatenate(targets)[told] - rows @ mean)
        drift, factor = np.zeros((rows.shape[1], 0)), np.ones(len(values))
        if tag.mean is not None:
            factor = np.clip(values / mean, *FACTORS)
            seen = rows @ tag.mean.drift
            inner = seen.T @ measured.solve(seen)
            inner[np.diag_indices_from(inner)] += 1.0
            drift = tag.mean.drift @ np.linalg.inv(np.linalg.cholesky(inner)).T
        base = tag.covariance, told, rows, images, measured
        share = abs(rows) @ sp.diags_array(abs(mean))
        known = drift, rows @ drift, factor, share @ factor / share.sum(axis=1)
        return cls(*base, columns, touching, *known)

    def covariance(self, rows: sp.csr_array, height: int) -> Array:
        """As of `Posterior`."""
        return super().covariance(sp.csr_array(rows * self.factor), height)

    def _gained(self, rows: sp.csr_array, height: int) -> Array:
        errors = self._known_errors
        cross = self._cross(rows)
        gain = self.measured.solve(cross.T).T
        mean, own, total, noise = (
            part.reshape(-1, height, part.shape[1])
            for part in (
                rows @ self.drift - gain @ self.drift_rows,
                gain,
                cross + gain,
                errors.roots(gain / self.row_factor),
            )
        )
        known = mean @ mean.transpose(0, 2, 1) - own @ total.transpose(0, 2, 1)
        return np.asarray(noise @ noise.transpose(0, 2, 1) + errors.variance * known)

    def _cross(self, rows: sp.csr_array) -> Array:
        """X, few rows at a time: each has a column for every measured voxel."""
        few = (rows[i : i + AT_ONCE] for i in range(0, rows.shape[0], AT_ONCE))
        return np.concatenate([self.columns.of_rows(r) @ self.touching.T for r in few])

    def draw(self, count: int, voxels: IntArray | None = None) -> Float32Array:
        """As of `Posterior`."""
        draws = super().draw(count, voxels)
        draws *= self.factor if voxels is None else self.factor[voxels]
        return draws

    def _draw_noise(self, rng: np.random.Generator) -> Array:
        return super()._draw_noise(rng) / self.row_factor

    def _draw_prior(self, rng: np.random.Generator) -> Array:
        mean = self.drift @ rng.standard_normal(self.drift.shape[1])
        return self.prior.draw(rng) + mean

    def _estimate(self, samples: Array, voxels: IntArray | None) -> Array:
        at = slice(None) if voxels is None else voxels
        loads = self.measured.solve(samples.T).T @ self.touching
        return np.stack([self.columns.times(load)[at] for load in loads])
