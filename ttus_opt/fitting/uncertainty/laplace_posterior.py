"""The posterior of a field with a Laplace prior, by a reduced basis.

The prior is p ~ N(p₀, C), C = L⁻¹Ω L⁻ᵀ. N C Nᵀ takes one solve with Lᵀ per row. The
measurements enter through the basis of `solvers.dual.weight_sweep`: fields ψᵢ,
orthonormal in the energy norm of the prior, with coefficients c ~ N(0, 1). With B their
weighted images, c is estimated from y = Bᵀc + e by M⁻¹B y, M = 1 + BBᵀ. If c has the
variance v and e the covariance Σ, the error of that estimate has the covariance
v M⁻² + M⁻¹BΣBᵀM⁻¹. A draw is a draw of the prior minus its estimate from its own noisy
measurements (Matheron's rule: A. G. Journel, C. J. Huijbregts, Mining Geostatistics,
1978). See docs/method/identification.md, Uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.fitting.uncertainty.posterior import (
    Float32Array,
    Posterior,
    WeightedData,
    kept_rows,
)
from ttus_opt.solvers.dual.data import DualData
from ttus_opt.solvers.dual.system import DualSystem
from ttus_opt.solvers.dual.weight_sweep import WeightSweep

#: Trace of the covariance, in units of the noise, that the basis may miss; it counts as
#: unknown [–]
MISSING = 0.2

#: Draws corrected together, so that the basis is read once for all of them
BATCH = 32

#: Relative residual of the solves [–]
RTOL = 1e-6

#: Prior standard deviation of a fitted boundary scale, over the field's σ: practically
#: without influence [–]
SCALE_DEVIATION = 1e3


@dataclass(frozen=True)
class LaplacePosterior(Posterior):
    """The error of a fit with a Laplace prior.

    Attributes:
        system: Dual of its problem.
        base: p₀ times the standard deviation of its scale, shape (V,); None if known.
        fields: ψ at ``voxels``, shape (k, n), in single precision; at all voxels in
            double precision if ``voxels`` is None.
        gain: M⁻¹; with ``base``, its last row and column belong to p₀.
        voxels: Voxels at which the fields are stored; None for all.
    """

    system: DualSystem = field(repr=False)
    base: Array | None = field(repr=False)
    fields: NDArray[np.floating] = field(repr=False)
    gain: Array = field(repr=False)
    voxels: IntArray | None = field(default=None, repr=False)

    @classmethod
    def of(
        cls, data: DualData, root: Array, scale: bool, voxels: IntArray | None = None
    ) -> LaplacePosterior:
        """Build the basis.

        Args:
            data: The problem.
            root: Square roots of the rows' weights, shape (m,) [–].
            scale: Whether the scale of p₀ is unknown.
            voxels: Voxels at which fields are stored, shape (n,); None for all.
        """
        sweep = WeightSweep(data, field_rtol=RTOL, voxels=voxels)
        sweep.complete(root, MISSING)
        images, fields = sweep.images, sweep.take_fields()
        own, base = root[sweep.informative], None
        if scale:
            base = SCALE_DEVIATION * sweep.base
            image = np.asarray(data.system.rows[sweep.informative] @ base)
            images = np.concatenate([images, image[None]])
        measured = WeightedData.of(images * own, own * sweep.misfit)
        gram = measured.weighted @ measured.weighted.T
        gram[np.diag_indices_from(gram)] += 1.0
        gain = scipy.linalg.inv(gram)
        return cls(sweep.informative, measured, data.system, base, fields, gain, voxels)

    @cached_property
    def inner(self) -> Array:
        """Covariance of the coefficients' errors, ordered as `gain`."""
        assert self.errors is not None
        noise = self.gain @ self.errors.roots(self.measured.weighted)
        return np.asarray(
            self.errors.variance * self.gain @ self.gain + noise @ noise.T
        )

    def covariance(self, rows: sp.csr_array, height: int) -> Array:
        """Implements `Posterior`, by one solve per nonempty row.

        NaN where a block touches voxels without stored basis.
        """
        assert self.errors is not None
        laplace = self.system.laplace
        root = np.sqrt(self.errors.variance * self.system.compliance)
        kept, missing = rows, np.zeros(rows.shape[0] // height, dtype=bool)
        if self.voxels is not None:
            kept, missing = kept_rows(rows, self.voxels, height)
        known = np.asarray(kept @ self.fields.T)
        n_prior = known.shape[1]
        if self.base is not None:
            known = np.column_stack([known, rows @ self.base])
        out = np.zeros((rows.shape[0] // height, height, height))
        filled = np.diff(rows.indptr).reshape(-1, height) > 0
        out[missing] = np.nan
        for k in np.flatnonzero(filled.any(axis=1) & ~missing).tolist():
            block = slice(k * height, (k + 1) * height)
            loads = rows[block].toarray()
            slopes = np.stack(
                [root * laplace.solve_adjoint(load, rtol=RTOL) for load in loads]
            )
            a, own = known[block], known[block, :n_prior]
            rest = slopes @ slopes.T - self.errors.variance * own @ own.T
            out[k] = rest + a @ self.inner @ a.T
        return out

    def draw(self, count: int, voxels: IntArray | None = None) -> Float32Array:
        """Implements `Posterior`: a solve per draw, three without a stored basis."""
        assert self.errors is not None
        rng, laplace = np.random.default_rng(0), self.system.laplace
        deviation = np.sqrt(self.errors.variance)
        root, V = np.sqrt(self.system.compliance), self.system.rows.shape[1]
        rows = self.system.rows[self.informative]
        weights = self.system.root_weights[self.informative]
        at = slice(None) if voxels is None else voxels
        by_basis = self.voxels is None or voxels is self.voxels
        coefficients = np.empty((count, len(self.fields)), self.fields.dtype)
        out = np.empty((count, V if voxels is None else len(voxels)), dtype=np.float32)
        for k in range(count):
            p = laplace.solve(root * rng.standard_normal(V), rtol=RTOL)
            if self.base is not None:
                p += rng.standard_normal() * self.base
            p *= deviation
            samples = weights * (rows @ p) + self.errors.draw(rng)
            if by_basis:
                c = self.gain @ (self.measured.weighted @ samples)
                coefficients[k] = c[: len(self.fields)]
                if self.base is not None:  # far larger than a draw: double precision
                    p -= c[-1] * self.base
                out[k] = p[at]
            else:
                out[k] = p[at] - self._estimate(samples, voxels)
        if by_basis:
            for start in range(0, count, BATCH):
                batch = slice(start, start + BATCH)
                estimate = coefficients[batch] @ self.fields
                out[batch] -= estimate if self.voxels is not None else estimate[:, at]
        return out

    def _estimate(self, samples: Array, voxels: IntArray | None) -> Array:
        """The estimate from weighted measurements at some voxels, by two solves."""
        y = self.measured.solve(samples)
        spread = np.zeros(len(self.informative))
        spread[self.informative] = y
        p = self.system.response(spread, RTOL)
        if self.base is not None:
            p += (self.measured.weighted[-1] @ y) * self.base
        return p if voxels is None else p[voxels]
