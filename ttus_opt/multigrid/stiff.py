"""Multigrid where voxels of a spoke are tied together: one value for a whole chain.

The operator is PᵀA P, P giving every voxel of a chain its chain's one value. It is
solved by conjugate gradients in double precision, preconditioned by a V-cycle whose
radial links inside chains are made so stiff that radial lines, which the smoother
solves exactly, move as one.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.compiled import compiled
from ttus_opt.errors import NumericalError
from ttus_opt.grid import CylindricalGrid
from ttus_opt.multigrid import double
from ttus_opt.multigrid.cycle import Hierarchy
from ttus_opt.multigrid.kernels import FAST
from ttus_opt.multigrid.levels import conductances
from ttus_opt.multigrid.solver import MultigridResult
from ttus_opt.multigrid.v_cycle import VCycle

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Conductance of a tie over that of its link: near enough to none, and far enough
#: from where single precision loses the rest
STIFFNESS = 1e3


# Vector work is compiled, on one core: a threaded BLAS waits for a core that is busy.


@compiled(nogil=True, fastmath=FAST)
def _dot(a: Array, b: Array) -> float:
    total = 0.0
    for n in range(a.size):
        total += a[n] * b[n]
    return total


@compiled(nogil=True, fastmath=FAST)
def _turn(direction: Array, z: Array, beta: float) -> None:
    """Next direction (compiled)."""
    for n in range(z.size):
        direction[n] = z[n] + beta * direction[n]


@compiled(nogil=True, fastmath=FAST)
def _step(x: Array, r: Array, direction: Array, image: Array, length: float) -> float:
    """One step, in place; returns r · r (compiled)."""
    total = 0.0
    for n in range(x.size):
        x[n] += length * direction[n]
        r[n] -= length * image[n]
        total += r[n] * r[n]
    return total


class StiffMultigrid:
    """Solver of PᵀA P z = b; z and b stand at one voxel of every chain.

    Vectors are (V,) as those of `Multigrid`, zero but at free voxels outside chains
    and at every chain's representative.
    """

    def __init__(
        self, grid: CylindricalGrid, free: Mask, ties: Mask, representative: Mask
    ) -> None:
        """Build the levels.

        Args:
            grid: The grid.
            free: Unknown voxels, shape (V,); a chain is free as a whole.
            ties: Voxels tied to the next one outwards, shape (V,).
            representative: Free voxels outside chains, and one of each, shape (V,).
        """
        self.grid, self._free, self._shown = grid, free, representative
        self._conductances = conductances(grid)
        self._hierarchy = Hierarchy.build(
            grid,
            grid.unflatten(free),
            np.where(grid.unflatten(ties), np.float32(STIFFNESS), np.float32(1.0)),
        )
        self._spread = _spread(free, ties, representative, grid.strides[0])
        self._gather = sp.csr_array(self._spread.T)
        self._cycle = self.rough()
        self._places = self._cycle.places(np.flatnonzero(representative))

    def rough(self) -> VCycle:
        """One V-cycle at a time, in arrays of its own and without copies."""
        return VCycle(self._hierarchy, self.grid.shape)

    def apply(self, z: Array) -> Array:
        """PᵀA P z, shape (V,)."""
        p, out = self._spread @ z, np.zeros_like(z)
        double.operate(out, p, self._free, *self._conductances, self.grid.shape)
        return np.asarray(self._gather @ out)

    def solve(
        self, rhs: Array, *, rtol: float = 1e-12, max_iterations: int = 500
    ) -> MultigridResult:
        """Solve PᵀA P z = b.

        Args:
            rhs: b, shape (V,).
            rtol: Relative residual asked for [–].
            max_iterations: Most V-cycles [–].

        Returns:
            Solution, V-cycles and relative residual, as it was carried along.

        Raises:
            NumericalError: The residual was not reached.
        """
        r = np.where(self._shown, rhs, 0.0)
        size = math.sqrt(_dot(r, r))
        x = np.zeros_like(r)
        if size == 0.0:
            return MultigridResult(x, 0, 0.0)
        before, direction, old = math.inf, np.zeros_like(r), np.zeros_like(r)
        for iteration in range(1, max_iterations + 1):
            z = self._roughly(r)
            # Polak and Ribière's β: the V-cycle is symmetric to single precision only
            now = _dot(z, r)
            _turn(direction, z, (now - _dot(z, old)) / before)
            before = now
            image = self.apply(direction)
            old[:] = r
            left = math.sqrt(
                _step(x, r, direction, image, now / _dot(direction, image))
            )
            if left <= rtol * size:
                return MultigridResult(x, iteration, left / size)
        raise NumericalError(
            f"multigrid reached a relative residual of {left / size:.1e} in "
            f"{max_iterations} cycles where {rtol:.1e} was asked for"
        )

    def _roughly(self, r: Array) -> Array:
        """One V-cycle for r."""
        largest = float(np.abs(r).max())
        self._cycle.b[self._places] = r[self._shown] / largest
        self._cycle.run()
        z = np.zeros_like(r)
        z[self._shown] = self._cycle.x[self._places]
        z *= largest
        return z


def _spread(free: Mask, ties: Mask, representative: Mask, stride: int) -> sp.csr_array:
    """P, from representatives to all free voxels, shape (V, V)."""
    n = len(free)
    head = np.arange(n)
    for start in range(stride, n, stride):  # a layer takes over what it is tied to
        own, inner = slice(start, start + stride), slice(start - stride, start)
        head[own] = np.where(ties[inner], head[inner], head[own])
    shown = np.full(n, -1)
    shown[head[representative]] = np.flatnonzero(representative)
    rows = np.flatnonzero(free)
    columns = shown[head[rows]]
    return sp.csr_array((np.ones(len(rows)), (rows, columns)), shape=(n, n))
