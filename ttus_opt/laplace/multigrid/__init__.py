"""Geometric multigrid for Laplace's equation on the voxel grid.

The rest of the package sees `solver` and `v_cycle` (a preconditioner). Below them, from
top to bottom: `refinement` in double precision, `pcg`, `pooled_blocks`, `workspace`
with its V-cycle, `hierarchy` with `subdomain` and `coarsening`, and the compiled
`line_smoother`, `transfer` and `kernels` on vectors in `red_black` order.
"""

from ttus_opt.laplace.multigrid.coarsening import Added, Grounds
from ttus_opt.laplace.multigrid.pooled_blocks import PooledBlocks
from ttus_opt.laplace.multigrid.solver import Multigrid, MultigridResult, OneCycle
from ttus_opt.laplace.multigrid.v_cycle import VCycle

__all__ = [
    "Added",
    "Grounds",
    "Multigrid",
    "MultigridResult",
    "OneCycle",
    "PooledBlocks",
    "VCycle",
]
