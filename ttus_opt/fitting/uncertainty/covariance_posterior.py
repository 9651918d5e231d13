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
from scipy.sparse.linalg import spsolve

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.fitting.uncertainty.posterior import Float32Array, Posterior
from ttus_opt.gaussian.conditioned import conditioned
from ttus_opt.gaussian.matern import VoxelColumns
from ttus_opt.gaussian.prior import partial_root, square_root
from ttus_opt.problem.members import ProgramTerm, StackedTerms

#: Rows whose covariance with all measured voxels is formed at once
AT_ONCE = 64

#: Voxels among which C is formed, and its root, at most: for 5,089 voxels and 11,640
#: rows that takes half the time of a root of D C Dᵀ, for 18,113 it would take minutes
DENSE = 6_000

#: Part of the largest variance of a measured row that its images may leave out [–]
ROUNDING = 1e-12

#: Least and largest p̂/φ: a linear fit may leave the range of a factor [–]
FACTORS = 0.3, 3.0


@dataclass(frozen=True)
class CovariancePosterior(Posterior):
    """The error of a fit with a prior of known covariance.

    Attributes:
        columns: Columns of C at the n voxels that measured rows touch.
        touching: D over these voxels, shape (rows, n).
        drift: H (1 + HᵀDᵀ S⁻¹ D H)^(−1/2), shape (V, k); H is zero for ln ℓ₀.
        drift_rows: The same of D H, and of what ln ℓ₀ changes, shape (rows, k).
        size: The same of ln ℓ₀, shape (k,) [–].
        factor: p̂/φ, within `FACTORS`; 1 of a prior without an uncertain mean, (V,).
        row_factor: Its mean over the voxels of every row of D, shape (rows,).
    """

    columns: VoxelColumns = field(repr=False)
    touching: sp.csr_array = field(repr=False)
    drift: Array = field(repr=False)
    drift_rows: Array = field(repr=False)
    size: Array = field(repr=False)
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
        tag = prior.known_covariance
        assert tag is not None
        stacked = StackedTerms.of(terms, len(values), prior.weight)
        told = np.diff(stacked.matrix.indptr) > 0
        rows, target = stacked.weighted[told], stacked.root * stacked.target
        mean = tag.covariance.times(prior.matrix.T @ prior.target)
        columns = tag.covariance.columns(np.unique(rows.indices).astype(np.int64))
        touching = sp.csr_array(rows.tocsc()[:, columns.voxels])
        images = _images(columns, rows, touching)
        measured = conditioned(images, target[told] - rows @ mean)
        base = tag.covariance, told, rows, images, measured, columns, touching
        if tag.mean is None:
            none, ones = np.zeros((rows.shape[1], 0)), np.ones(len(values))
            return cls(*base, none, rows @ none, none[0], ones, np.ones(rows.shape[0]))
        factor, share = np.clip(values / mean, *FACTORS), abs(rows) * abs(mean)
        row_factor = share @ factor / share.sum(axis=1)
        slopes = tag.mean.size_deviation * np.repeat(tag.mean.size_slopes, 3)
        sized = stacked.root * np.concatenate([times(t, mean, slopes) for t in terms])
        seen = np.column_stack([rows @ tag.mean.drift, sized[told]])
        inner = seen.T @ measured.solve(seen)
        inner[np.diag_indices_from(inner)] += 1.0
        root = np.linalg.inv(np.linalg.cholesky(inner)).T
        drift, size = tag.mean.drift @ root[:-1], tag.mean.size_deviation * root[-1]
        return cls(*base, drift, seen @ root, size, factor, row_factor)

    def covariance(
        self, rows: sp.csr_array, height: int, sized: Array | None = None
    ) -> Array:
        """As of `Posterior`."""
        return super().covariance(sp.csr_array(rows * self.factor), height, sized)

    def _gained(self, rows: sp.csr_array, height: int, sized: Array) -> Array:
        errors = self.errors
        cross = self._cross(rows)
        gain = self.measured.solve(cross.T).T
        mean, own, total, noise = (
            part.reshape(-1, height, part.shape[1])
            for part in (
                rows @ self.drift + np.outer(sized, self.size) - gain @ self.drift_rows,
                gain,
                cross + gain,
                gain / self.row_factor @ errors.root,
            )
        )
        known = mean @ mean.transpose(0, 2, 1) - own @ total.transpose(0, 2, 1)
        return np.asarray(noise @ noise.transpose(0, 2, 1) + errors.variance * known)

    def _cross(self, rows: sp.csr_array) -> Array:
        """X, few rows at a time: each has a column for every measured voxel."""
        return _cross(self.columns, rows, self.touching)

    def draw(
        self, count: int, voxels: IntArray | None = None
    ) -> tuple[Float32Array, Array]:
        """As of `Posterior`."""
        draws, sizes = super().draw(count, voxels)
        draws *= self.factor if voxels is None else self.factor[voxels]
        return draws, sizes

    def _drawn(self, rng: np.random.Generator) -> tuple[Array, Array, float]:
        errors = self.errors
        known = np.sqrt(errors.variance) * rng.standard_normal(len(self.size))
        p = np.sqrt(errors.variance) * self.prior.draw(rng)
        samples = self.rows @ p + self.drift_rows @ known
        samples += errors.draw(rng) / self.row_factor
        return p + self.drift @ known, samples, float(self.size @ known)

    def _estimate(self, samples: Array, voxels: IntArray | None) -> Array:
        at = slice(None) if voxels is None else voxels
        loads = self.measured.solve(samples.T).T @ self.touching
        return np.stack([self.columns.times(load)[at] for load in loads])


def _cross(columns: VoxelColumns, rows: sp.csr_array, touching: sp.csr_array) -> Array:
    """Covariance of some rows with those measured, few at a time, shape (k, rows)."""
    out = np.empty((rows.shape[0], touching.shape[0]))
    for first in range(0, len(out), AT_ONCE):
        some = slice(first, first + AT_ONCE)
        out[some] = (touching @ columns.of_rows(rows[some]).T).T
    return out


def _images(columns: VoxelColumns, rows: sp.csr_array, touching: sp.csr_array) -> Array:
    """B with BᵀB = D C Dᵀ, shape (k, rows).

    By a root of C where it is small, else by one of D C Dᵀ, of which only the columns
    of pivots are formed.

    Args:
        columns: C at the n voxels that D touches.
        rows: D, shape (rows, V).
        touching: The same over these voxels, shape (rows, n).
    """
    if touching.shape[1] <= DENSE:
        return np.ascontiguousarray((touching @ square_root(columns.among)).T)
    variance = np.empty(rows.shape[0])
    for first in range(0, len(variance), AT_ONCE):
        some = slice(first, first + AT_ONCE)
        own = touching[some] * columns.of_rows(rows[some])
        variance[some] = own.sum(axis=1)
    return partial_root(
        variance, lambda some: _cross(columns, rows[some], touching).T, ROUNDING
    ).T


def wrenches(term: ProgramTerm, values: Array) -> Array:
    """The measured components that a field renders, shape (3T,) [N, N·m]."""
    rendered, by = term.matrix @ values, term.whitening
    return rendered if by is None else np.asarray(spsolve(sp.csc_array(by), rendered))


def times(term: ProgramTerm, values: Array, factors: Array) -> Array:
    """What the term's rows are of such components times factors, shape (3T,)."""
    out, by = factors * wrenches(term, values), term.whitening
    return out if by is None else np.asarray(by @ out)
