"""Compiling the multigrid in a second process while the first reads its data.

Compiling takes most of a first run and holds the interpreter's lock. Each process takes
from the cache what the other has compiled, and waits for what the other is compiling
(`ttus_opt.core.compiled`).
"""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Iterator

import numpy as np

from ttus_opt.core.child_process import environment, python_module
from ttus_opt.core.compiled import is_cached
from ttus_opt.laplace.multigrid.pcg import operate
from ttus_opt.laplace.multigrid.refinement import add, add_flat
from ttus_opt.laplace.multigrid.solver import Multigrid
from ttus_opt.laplace.multigrid.workspace import v_cycle
from ttus_opt.voxmap.grid import CylindricalGrid

#: The functions that are compiled last, or take longest
LAST = (add_flat, operate, v_cycle)


@contextlib.contextmanager
def compiling_ahead() -> Iterator[None]:
    """Compile the multigrid in another process meanwhile, unless it is compiled."""
    helper = None
    if not all(map(is_cached, LAST)):
        helper = subprocess.Popen(
            python_module("ttus_opt.laplace.multigrid.ahead"),
            env=environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    try:
        yield
    finally:
        if helper is not None:
            helper.terminate()
            helper.wait()


def compile_multigrid() -> None:
    """Solve on a small grid: compiled code does not depend on the size.

    First the V-cycle, which is half of the work, then the other kernels of a solve from
    last to first: a process that starts its own first solve meanwhile begins at the
    other end, and the two share the rest.
    """
    grid = CylindricalGrid(0.03, 0.18, 0.0, 0.3, shape=(8, 16, 8))
    free = np.zeros(grid.shape, dtype=np.bool_)
    free[1:-1, :, 1:-1] = True
    multigrid = Multigrid(grid, free)
    multigrid.preconditioner().run()
    work = multigrid._taken()
    add(np.zeros(grid.n_voxels), work.answer, 1.0, multigrid._operator)
    work._step(1.0)
    work._operate()
    multigrid.solve(np.ones(grid.n_voxels))


if __name__ == "__main__":
    compile_multigrid()
