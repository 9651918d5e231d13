"""Multigrid with aggregated voxels: one value for a pooled block along a spoke.

The operator is PᵀA P, where P gives every voxel of a block the value of its block.
Blocks lie in radial lines, which the smoother solves exactly; links within a block are
so strong that, in single precision, both ends have the same value. All that is left is
to sum residuals over blocks.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.threads import in_parts
from ttus_opt.laplace.multigrid import refinement
from ttus_opt.laplace.multigrid.coarsening import Grounds
from ttus_opt.laplace.multigrid.pcg import Vectors
from ttus_opt.laplace.multigrid.pooled_blocks import PooledBlocks
from ttus_opt.laplace.multigrid.solver import Multigrid, MultigridResult, largest_size
from ttus_opt.voxmap.grid import CylindricalGrid


class AggregatedMultigrid(Multigrid):
    """Solver of PᵀA P z = b, with z and b stored at one voxel of every block.

    Vectors are (V,) as those of `Multigrid`, zero except at free voxels outside
    blocks and at every block's leader. In all other respects it is a `Multigrid`.
    """

    def __init__(
        self,
        grid: CylindricalGrid,
        free: Mask,
        pooled: Mask,
        leads: Mask,
        *,
        screening: Array | None = None,
        grounds: Grounds | None = None,
    ) -> None:
        """Build the levels.

        Args:
            grid: The grid.
            free: Unknown voxels, shape (V,); a block is free as a whole.
            pooled: Voxels pooled with the next one outwards, shape (V,).
            leads: Free voxels outside blocks, and one of each, shape (V,).
            screening: As in `Multigrid`.
            grounds: Likewise.
        """
        self._leads = leads
        self._blocks = PooledBlocks.of(free, pooled, leads, grid.strides[0])
        super().__init__(
            grid,
            grid.unflatten(free),
            pooled=grid.unflatten(pooled),
            screening=screening,
            grounds=grounds,
        )
        self.norm_bound *= math.sqrt(self._blocks.longest)

    def __reduce__(self) -> tuple[Callable[..., Multigrid], tuple[object, ...]]:
        """Pickle as what it was built from."""
        assert self._pooled is not None
        pooled = self.grid.flatten(self._pooled)
        built = (self.grid, self.free, pooled, self._leads)
        screening, grounds = self.screening, self.grounds
        make = partial(AggregatedMultigrid, screening=screening, grounds=grounds)
        return make, built

    def solve(self, rhs: Array, *, rtol: float = 1e-12) -> MultigridResult:
        """Solve PᵀA P z = b; as `Multigrid.solve`."""
        answer = super().solve(rhs, rtol=rtol)
        answer.x[self._blocks.followers] = 0.0
        return answer

    def _vectors(self) -> Vectors:
        return Vectors(self.hierarchy, self._blocks)

    def _vector(self, values: Array) -> tuple[Array, float]:
        vector, _ = super()._vector(values)
        vector[self._blocks.followers] = 0.0
        return vector, largest_size(vector)

    def _residual(
        self, work: Vectors, x: Array | None, b: Array, scale: float
    ) -> float:
        if x is not None:
            self._blocks.prolong(x)
            b = b - self._product(x)
            self._blocks.restrict(b)
        return super()._residual(work, None, b, scale)

    def _product(self, x: Array) -> Array:
        """A x for a vector that is zero at fixed voxels."""
        out = np.zeros_like(x)
        in_parts(partial(refinement.operate, out, x, self._operator), self._parts)
        return out
