"""Geometric multigrid for Laplace's equation on the voxel grid.

`solver` and `stiff` are what the rest of the package sees; below them, from top to
bottom, `v_cycle`, `window`, `gradients`, `chains`, `cycle`, `levels`, and the compiled
loops: `lines`, `transfer`, `kernels`, `double`.
"""

from ttus_opt.multigrid.aggregated import StiffMultigrid
from ttus_opt.multigrid.solver import Multigrid, MultigridResult
from ttus_opt.multigrid.v_cycle import VCycle

__all__ = ["Multigrid", "MultigridResult", "StiffMultigrid", "VCycle"]
