"""Geometric multigrid for Laplace's equation on the voxel grid.

`solver` is what the rest of the package sees; below it, from top to bottom, `v_cycle`,
`cycle`, `levels`, and the compiled loops: `lines`, `transfer`, `kernels`, `double`.
"""

from ttus_opt.multigrid.solver import Multigrid, MultigridResult
from ttus_opt.multigrid.v_cycle import VCycle

__all__ = ["Multigrid", "MultigridResult", "VCycle"]
