"""Multigrid where voxels of a spoke are tied together: one value for a whole chain.

The operator is PᵀA P, P giving every voxel of a chain its chain's one value. It is
solved by conjugate gradients in double precision, preconditioned by a V-cycle whose
radial links inside chains are made so stiff that radial lines, which the smoother
solves exactly, move as one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ttus_opt.compiled import compiled
from ttus_opt.errors import NumericalError
from ttus_opt.grid import CylindricalGrid
from ttus_opt.multigrid import double
from ttus_opt.multigrid.cycle import Hierarchy
from ttus_opt.multigrid.kernels import FAST, Single
from ttus_opt.multigrid.levels import conductances
from ttus_opt.multigrid.solver import MultigridResult
from ttus_opt.multigrid.v_cycle import VCycle

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

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


@compiled(nogil=True)
def _spread(p: Array, z: Array, unknown: Index) -> None:
    """P z (compiled)."""
    for n in range(p.size):
        p[n] = z[unknown[n]] if unknown[n] >= 0 else 0.0


@compiled(nogil=True)
def _gather(z: Array, p: Array, unknown: Index) -> None:
    """Add Pᵀp (compiled)."""
    for n in range(p.size):
        if unknown[n] >= 0:
            z[unknown[n]] += p[n]


@compiled(nogil=True)
def _load(b: Single, r: Array, places: Index, voxels: Index) -> None:
    for n in range(places.size):
        b[places[n]] = r[voxels[n]]


@compiled(nogil=True)
def _unload(z: Array, x: Single, places: Index, voxels: Index) -> None:
    for n in range(places.size):
        z[voxels[n]] = x[places[n]]


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
        self._ties = ties
        self._stiffness = np.where(
            grid.unflatten(ties), np.float32(STIFFNESS), np.float32(1.0)
        )
        self._hierarchy = Hierarchy.build(grid, grid.unflatten(free), self._stiffness)
        self._unknown = _unknown(free, ties, representative, grid.strides[0])
        self._cycle = self.rough()
        self._voxels = np.flatnonzero(representative)
        self._places = self._cycle.places(self._voxels)

    def rough(self, near: NDArray[np.integer] | None = None) -> VCycle:
        """One V-cycle at a time, as `Multigrid.rough`; it knows all chains."""
        if near is not None:  # a chain that is cut would be held fixed
            near = np.union1d(near, np.flatnonzero(self._ties))
        return VCycle.near(
            near, self._hierarchy, self.grid, self._free, self._stiffness
        )

    def apply(self, z: Array) -> Array:
        """PᵀA P z, shape (V,)."""
        p, image, out = np.empty_like(z), np.empty_like(z), np.zeros_like(z)
        _spread(p, z, self._unknown)
        double.operate(image, p, self._free, *self._conductances, self.grid.shape)
        _gather(out, image, self._unknown)
        return out

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
        x, z = np.zeros_like(r), np.zeros_like(r)
        if size == 0.0:
            return MultigridResult(x, 0, 0.0)
        r /= size  # single precision takes it as it is
        before, direction, old = math.inf, np.zeros_like(r), np.zeros_like(r)
        for iteration in range(1, max_iterations + 1):
            _load(self._cycle.b, r, self._places, self._voxels)
            self._cycle.run()
            _unload(z, self._cycle.x, self._places, self._voxels)
            # Polak and Ribière's β: the V-cycle is symmetric to single precision only
            now = _dot(z, r)
            _turn(direction, z, (now - _dot(z, old)) / before)
            before = now
            image = self.apply(direction)
            old[:] = r
            left = math.sqrt(
                _step(x, r, direction, image, now / _dot(direction, image))
            )
            if left <= rtol:
                x *= size
                return MultigridResult(x, iteration, left)
        raise NumericalError(
            f"multigrid reached a relative residual of {left:.1e} in "
            f"{max_iterations} cycles where {rtol:.1e} was asked for"
        )


def _unknown(
    free: Mask, ties: Mask, representative: Mask, stride: int
) -> NDArray[np.int64]:
    """The voxel at which each free voxel's unknown stands, -1 at others, (V,)."""
    n = len(free)
    head = np.arange(n)
    for start in range(stride, n, stride):  # a layer takes over what it is tied to
        own, inner = slice(start, start + stride), slice(start - stride, start)
        head[own] = np.where(ties[inner], head[inner], head[own])
    shown = np.full(n, -1)
    shown[head[representative]] = np.flatnonzero(representative)
    return np.where(free, shown[head], -1)
