"""A⁻¹ approximated by one V-cycle; A may have added conductances and screening.

The map b ↦ x is linear, symmetric and positive definite up to single precision, as a
preconditioner must be. With several sweeps on the finest level it is close to A⁻¹ in
the Euclidean norm and not only in the energy norm: two such maps in a row are then
spectrally equivalent to A⁻².
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.laplace.multigrid import refinement
from ttus_opt.laplace.multigrid.coarsening import Added, Grounds, conductances
from ttus_opt.laplace.multigrid.hierarchy import Hierarchy
from ttus_opt.laplace.multigrid.solver import MultigridResult
from ttus_opt.laplace.multigrid.v_cycle import VCycle
from ttus_opt.laplace.multigrid.workspace import Workspace
from ttus_opt.voxmap.grid import CylindricalGrid

#: Sweeps before and after on the finest level [–]: on M, 49 steps of conjugate
#: gradients with one sweep are 16 with two
SWEEPS = 2


class OneCycle:
    """One V-cycle on free voxels; vectors are (V,), zero at fixed ones."""

    def __init__(
        self,
        grid: CylindricalGrid,
        free: Mask,
        added: Added | None = None,
        pooled: Mask | None = None,
        leads: Mask | None = None,
        grounds: Grounds | None = None,
    ) -> None:
        """Build the levels.

        Args:
            grid: The grid.
            free: Unknown voxels, shape (V,).
            added: What is added to the operator; None for nothing.
            pooled: Voxels pooled with the next one outwards, shape (V,); None for none.
            leads: With pooled, the leaders of blocks and the free voxels outside them,
                as in `AggregatedMultigrid`.
            grounds: What cut links change in the operator; None for nothing.
        """
        if grounds is not None:
            added = replace(added or Added(), grounds=grounds)
        self._leads = leads
        self._grid, self._free, self._added, self._pooled = grid, free, added, pooled
        blocks = None if pooled is None else grid.unflatten(pooled)
        mask = np.ascontiguousarray(grid.unflatten(free))
        self._hierarchy = Hierarchy.build(grid, mask, blocks, added)
        pitch = self._hierarchy.levels[0].layout.pitch
        # of the plain operator, of which only the way to red-black order is used
        steps = conductances(grid)
        self._order = refinement.Operator.of(free, steps, (*grid.shape[1:], pitch))
        self._idle: deque[Workspace] = deque()

    def preconditioner(self, near: NDArray[np.integer] | None = None) -> VCycle:
        """One V-cycle near some voxels, as `Multigrid.preconditioner`."""
        whole = (self._hierarchy, self._grid, self._free, self._pooled, self._added)
        return VCycle.near(near, *whole)

    def solve(self, rhs: Array, *, rtol: float = 0.0) -> MultigridResult:
        """One V-cycle's answer.

        Args:
            rhs: b, shape (V,); values at fixed voxels are left out.
            rtol: Ignored: the accuracy of one V-cycle is fixed.

        Returns:
            The answer after one cycle; its residual is not computed.
        """
        x = np.zeros_like(rhs)
        most, least = (f(where=self._free, initial=0.0) for f in (rhs.max, rhs.min))
        largest = max(float(most), -float(least))
        if largest > 0.0:
            try:  # scratch arrays that no other thread has
                work = self._idle.pop()
            except IndexError:
                work = Workspace(self._hierarchy)
            refinement.residual(
                work.b, rhs, rhs, self._order, 1.0 / largest, is_zero=True
            )
            work.v_cycle(sweeps=SWEEPS)
            refinement.add(x, work.x, largest, self._order)
            self._idle.append(work)
        if self._leads is not None:
            x[~self._leads] = 0.0
        return MultigridResult(x, 1, np.nan)

    #: Aᵀ = A
    solve_adjoint = solve
