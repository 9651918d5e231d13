"""Laplace prior that does not depend on the grid, ∫ (ℓ² ∇²p)² dV/ℓ³.

Eq. 10 sums squares of Δr² ∇²p over voxels: halving every step halves that sum (2⁻⁴ for
each voxel, 2³ times as many), so that the meaning of λ depends on the grid. Here each
free row is weighted by its voxel's volume, with ℓ = 1 cm as unit of length. Boundary
values are not part of the integral: they belong in a constraint.

See docs/method/formulations.md, The shelf.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.problem.terms.base import AffineRows, Term
from ttus_opt.problem.terms.structure import LaplaceRows

#: Unit of length of the integral, ℓ [m]
LENGTH = 0.01


@dataclass(frozen=True)
class VolumeWeightedTerm(Term):
    """Squares of ∇²p over the free voxels, times their volume."""

    name = "volume_weighted"
    formula = "∫ (ℓ²∇²p)² dV/ℓ³"

    @property
    def _scale(self) -> Array:
        """√(volume/ℓ³)·(ℓ/Δr)² of every voxel, shape (V,) [–]."""
        grid = self.scene.laplace.grid
        step = grid.r_step * grid.theta_step * grid.z_step
        volume = self.scene.laplace.radii * step
        return np.asarray(np.sqrt(volume / LENGTH**3) * (LENGTH / grid.r_step) ** 2)

    def rows(self) -> AffineRows:
        """Free rows of L, each times √(volume/ℓ³)·(ℓ/Δr)²."""
        laplace = self.scene.laplace
        free = np.flatnonzero(laplace.free)
        of_voxels = self._scale
        scale = of_voxels[free]
        rows = sp.csr_array(sp.diags_array(scale) @ laplace.L[free])
        tags = frozenset({LaplaceRows("p", of_voxels)})
        return AffineRows({"p": rows}, scale * self.scene.b[free], tags)
