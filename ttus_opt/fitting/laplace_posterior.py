"""The posterior of a field with a Laplace prior, by a reduced basis.

The prior is p ~ N(p₀, C), C = L⁻¹Ω L⁻ᵀ. N C Nᵀ takes one solve with Lᵀ per row. The
rest is known by the basis of `solvers.dual.weight_sweep`: fields ψᵢ, orthonormal in the
prior's energy, whose coefficients have the prior N(0, 1) and, with B their weighted
images, the posterior covariance (1 + BBᵀ)⁻¹. A draw is one of the prior, corrected by
what its own noisy measurements say of it (Matheron's rule: A. G. Journel, C. J.
Huijbregts, Mining Geostatistics, 1978). See docs/method.md, Doubt.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from ttus_opt.arrays import Array, IntArray, Mask
from ttus_opt.fitting.posterior import MeasuredRows, Single, kept_rows
from ttus_opt.solvers.dual.data import DualData
from ttus_opt.solvers.dual.system import DualSystem
from ttus_opt.solvers.dual.weight_sweep import WeightSweep

#: Trace of the covariance, in units of the noise, that the basis may miss: what is
#: missed counts as unknown [–]
MISSING = 0.2

#: Relative residual of the solves [–]
RTOL = 1e-6

#: Prior standard deviation of a fitted boundary scale, over the field's σ: the data
#: alone tell it [–]
SCALE_DEVIATION = 1e3


@dataclass(frozen=True)
class LaplacePosterior:
    """The Gaussian of a problem, with σ² = 1.

    Attributes:
        system: Its dual.
        told: Rows that say something of the field, shape (m,).
        measured: What they say.
        base: p₀ times the deviation of its scale, shape (V,); None where it is known.
        fields: ψ at ``voxels``, shape (k, n); the last one is p₀ where its scale is
            unknown.
        inner: (1 + BBᵀ)⁻¹, shape (k, k).
        n_prior: Fields that are not p₀.
        voxels: Where the fields are kept; None for everywhere.
    """

    system: DualSystem = field(repr=False)
    told: Mask = field(repr=False)
    measured: MeasuredRows = field(repr=False)
    base: Array | None = field(repr=False)
    fields: Array = field(repr=False)
    inner: Array = field(repr=False)
    n_prior: int
    voxels: IntArray | None = field(default=None, repr=False)

    @classmethod
    def of(
        cls, data: DualData, root: Array, scale: bool, voxels: IntArray | None = None
    ) -> LaplacePosterior:
        """Build the basis.

        Args:
            data: The problem.
            root: Roots of the weights of its rows, shape (m,) [–].
            scale: Whether the scale of p₀ is unknown.
            voxels: Where fields are kept, shape (n,); None for everywhere.
        """
        sweep = WeightSweep(data, field_rtol=RTOL, voxels=voxels)
        sweep.complete(root, MISSING)
        images, n = sweep.images, len(sweep)
        fields = sweep.take_fields(more=int(scale))
        own, base = root[sweep.told], None
        if scale:
            base = SCALE_DEVIATION * sweep.base
            image = np.asarray(data.system.rows[sweep.told] @ base)
            fields[n] = base if voxels is None else base[voxels]
            images = np.concatenate([images, image[None]])
        measured = MeasuredRows.of(images * own, own * sweep.misfit)
        gram = measured.weighted @ measured.weighted.T
        gram[np.diag_indices_from(gram)] += 1.0
        inner = scipy.linalg.inv(gram)
        return cls(data.system, sweep.told, measured, base, fields, inner, n, voxels)

    def covariance(self, rows: sp.csr_array, height: int) -> Array:
        """Of blocks of rows, by a solve for each row that has an entry.

        NaN where a block touches voxels at which the basis is not kept.
        """
        laplace, root = self.system.laplace, np.sqrt(self.system.compliance)
        kept, missing = rows, np.zeros(rows.shape[0] // height, dtype=bool)
        if self.voxels is not None:
            kept, missing = kept_rows(rows, self.voxels, height)
        known = np.asarray(kept @ self.fields.T)
        out = np.zeros((rows.shape[0] // height, height, height))
        told = np.diff(rows.indptr).reshape(-1, height) > 0
        out[missing] = np.nan
        for k in np.flatnonzero(told.any(axis=1) & ~missing).tolist():
            block = slice(k * height, (k + 1) * height)
            loads = rows[block].toarray()
            slopes = np.stack(
                [root * laplace.solve_adjoint(load, rtol=RTOL) for load in loads]
            )
            a = known[block]
            rest = slopes @ slopes.T - a[:, : self.n_prior] @ a[:, : self.n_prior].T
            out[k] = rest + a @ self.inner @ a.T
        return out

    def draw(self, count: int, voxels: IntArray | None = None) -> Single:
        """Draws of the field around its mean, shape (count, n).

        Args:
            count: How many [–].
            voxels: Where, shape (n,); None for everywhere. Where the basis is not kept
                there, a draw takes three solves instead of one.
        """
        rng, laplace = np.random.default_rng(0), self.system.laplace
        root, V = np.sqrt(self.system.compliance), self.system.rows.shape[1]
        rows = self.system.rows[self.told]
        weights = self.system.root_weights[self.told]
        at = slice(None) if voxels is None else voxels
        out = np.empty((count, V if voxels is None else len(voxels)), dtype=np.float32)
        for k in range(count):
            p = laplace.solve(root * rng.standard_normal(V), rtol=RTOL)
            if self.base is not None:
                p += rng.standard_normal() * self.base
            said = weights * (rows @ p) + rng.standard_normal(len(weights))
            out[k] = p[at] - self._told_by(said, voxels)
        return out

    def _told_by(self, said: Array, voxels: IntArray | None) -> Array:
        """The mean field given measurements alone, at some voxels."""
        if self.voxels is None or voxels is self.voxels:
            told = (self.inner @ (self.measured.weighted @ said)) @ self.fields
            whole = self.voxels is None and voxels is not None
            return np.asarray(told[voxels] if whole else told)
        y = self.measured.solve(said)
        spread = np.zeros(len(self.told))
        spread[self.told] = y
        p = self.system.response(spread, RTOL)
        if self.base is not None:
            p += (self.measured.weighted[-1] @ y) * self.base
        return p if voxels is None else p[voxels]
