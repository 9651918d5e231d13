"""The error of a field with a Laplace prior, by a reduced basis.

N C Nᵀ takes one solve with Lᵀ per row. The measurements enter through the basis of
`solvers.dual.weight_sweep`: fields ψᵢ with coefficients c ~ N(0, 1), whose images are
B. With A = N ψ it is X = A B, and the errors of the estimated coefficients have, with
M = 1 + BBᵀ, the covariance v M⁻² + M⁻¹BΣBᵀM⁻¹. An unknown scale of p₀ is a field with
a very large coefficient.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.fitting.uncertainty.posterior import Posterior, kept_rows
from ttus_opt.gaussian.conditioned import ByImages
from ttus_opt.solvers.dual.data import DualData
from ttus_opt.solvers.dual.weight_sweep import WeightSweep

#: Trace of the covariance, in units of the noise, that the basis may miss; it counts as
#: unknown [–]
MISSING = 0.2

#: Relative residual of the solves [–]
RTOL = 1e-6

#: Prior standard deviation of a fitted boundary scale, over the field's σ: practically
#: without influence [–]
SCALE_DEVIATION = 1e3


@dataclass(frozen=True)
class LaplacePosterior(Posterior):
    """The error of a fit with a Laplace prior.

    Attributes:
        base: p₀ times the standard deviation of its scale, shape (V,), whose images are
            the last; None if known.
        fields: ψ at ``voxels``, shape (k, n), in single precision; at all voxels in
            double precision if ``voxels`` is None.
        voxels: Voxels at which the fields are stored; None for all.
    """

    measured: ByImages = field(repr=False)
    base: Array | None = field(repr=False)
    fields: NDArray[np.floating] = field(repr=False)
    voxels: IntArray | None = field(default=None, repr=False)

    @classmethod
    def of(
        cls, data: DualData, scale: bool, voxels: IntArray | None = None
    ) -> LaplacePosterior:
        """Build the basis.

        Args:
            data: The problem.
            scale: Whether the scale of p₀ is unknown.
            voxels: Voxels at which fields are stored, shape (n,); None for all.
        """
        sweep, root = WeightSweep(data, RTOL, voxels), data.system.root_weights
        sweep.complete(root, MISSING)
        images, fields, told = sweep.images, sweep.take_fields(), sweep.informative
        roots, base = root[told], None
        rows = sp.csr_array(sp.diags_array(roots) @ data.system.rows[told])
        images = images * roots
        if scale:
            base = SCALE_DEVIATION * sweep.base
            images = np.concatenate([images, (rows @ base)[None]])
        measured = ByImages.of(images, roots * sweep.misfit)
        prior = data.system.field_prior.within(RTOL)
        return cls(prior, told, rows, images, measured, base, fields, voxels)

    @cached_property
    def _inner(self) -> Array:
        """Covariance of the coefficients' errors, less that by the prior."""
        errors, spread = self.errors, self.measured.spread
        noise = spread @ (self.images @ errors.root)
        inner = errors.variance * spread @ spread + noise @ noise.T
        n_prior = len(self.fields)
        inner[np.diag_indices(n_prior)] -= errors.variance
        return np.asarray(inner)

    def _gained(self, rows: sp.csr_array, height: int, sized: Array) -> Array:
        kept, missing = rows, np.zeros(rows.shape[0] // height, dtype=bool)
        if self.voxels is not None:
            kept, missing = kept_rows(rows, self.voxels, height)
        images = np.asarray(kept @ self.fields.T)
        if self.base is not None:
            images = np.column_stack([images, rows @ self.base])
        images = images.reshape(-1, height, images.shape[1])
        gained = images @ self._inner @ images.transpose(0, 2, 1)
        gained[missing] = np.nan
        return np.asarray(gained)

    def _drawn(self, rng: np.random.Generator) -> tuple[Array, Array, float]:
        errors, p = self.errors, self.prior.draw(rng)
        if self.base is not None:
            p += rng.standard_normal() * self.base
        p *= np.sqrt(errors.variance)
        samples = self.rows @ p + errors.draw(rng)
        if self.base is not None:  # far larger than a draw: double precision
            p -= self.measured.coefficients(samples)[-1] * self.base
        return p, samples, 0.0

    def _estimate(self, samples: Array, voxels: IntArray | None) -> Array:
        """By the basis where it is stored, else by two solves each."""
        at = slice(None) if voxels is None else voxels
        if self.voxels is None or voxels is self.voxels:
            c = self.measured.coefficients(samples.T)[: len(self.fields)].T
            fields = c.astype(self.fields.dtype) @ self.fields
            return np.asarray(fields if self.voxels is not None else fields[:, at])
        loads = self.measured.solve(samples.T).T @ self.rows
        return np.stack([self.prior.times(load)[at] for load in loads])
