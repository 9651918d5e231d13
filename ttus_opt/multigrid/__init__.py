"""Geometric multigrid for Laplace's equation on the voxel grid.

`solver` is what the rest of the package sees; below it, from top to bottom, `cycle`,
`levels`, and the compiled loops: `lines`, `transfer`, `kernels`, `double`.
"""

from ttus_opt.multigrid.solver import Multigrid, MultigridResult

__all__ = ["Multigrid", "MultigridResult"]
