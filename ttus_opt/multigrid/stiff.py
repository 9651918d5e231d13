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
Index = NDArray[np.int32]

#: Conductance of a tie over that of its link: near enough to none, and far enough
#: from where single precision loses the rest
STIFFNESS = 1e3


# Vector work is compiled, on one core: a threaded BLAS waits for a core that is busy.
# Vectors hold the unknowns only, in the order of the voxels they stand at.


@compiled(nogil=True, fastmath=FAST)
def _dot(a: Array, b: Array) -> float:
    total = 0.0
    for n in range(a.size):
        total += a[n] * b[n]
    return total


@compiled(nogil=True, fastmath=FAST)
def _take(
    z: Array, x: Single, places: Index, r: Array, image: Array
) -> tuple[float, float]:
    """Take z over from a V-cycle; returns z · r and z · image (compiled)."""
    with_r, with_image = 0.0, 0.0
    for n in range(z.size):
        value = np.float64(x[places[n]])
        z[n] = value
        with_r += value * r[n]
        with_image += value * image[n]
    return with_r, with_image


@compiled(nogil=True, fastmath=FAST)
def _turn(direction: Array, z: Array, beta: float) -> None:
    """Next direction (compiled)."""
    for n in range(z.size):
        direction[n] = z[n] + beta * direction[n]


@compiled(nogil=True, fastmath=FAST)
def _step(
    x: Array,
    r: Array,
    direction: Array,
    image: Array,
    length: float,
    b: Single,
    places: Index,
) -> float:
    """One step, in place, and r handed to a V-cycle; returns r · r (compiled)."""
    total = 0.0
    for n in range(x.size):
        x[n] += length * direction[n]
        left = r[n] - length * image[n]
        r[n] = left
        b[places[n]] = left
        total += left * left
    return total


@compiled(nogil=True)
def _spread(p: Array, z: Array, unknown: Index) -> None:
    """P z (compiled)."""
    for n in range(p.size):
        p[n] = z[unknown[n]] if unknown[n] >= 0 else 0.0


@compiled(nogil=True)
def _gather(z: Array, p: Array, unknown: Index) -> None:
    """Pᵀp (compiled)."""
    z[:] = 0.0
    for n in range(p.size):
        if unknown[n] >= 0:
            z[unknown[n]] += p[n]


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
        self.grid, self._free = grid, free
        self._conductances = conductances(grid)
        self._ties = ties
        self._stiffness = np.where(
            grid.unflatten(ties), np.float32(STIFFNESS), np.float32(1.0)
        )
        self._hierarchy = Hierarchy.build(grid, grid.unflatten(free), self._stiffness)
        self._voxels = np.flatnonzero(representative)
        self._unknown = _unknown(free, ties, representative, grid.strides[0])
        self._cycle = self.rough()
        self._places = self._cycle.places(self._voxels).astype(np.int32)

    def rough(self, near: NDArray[np.integer] | None = None) -> VCycle:
        """One V-cycle at a time, as `Multigrid.rough`; it knows all chains."""
        if near is not None:  # a chain that is cut would be held fixed
            near = np.union1d(near, np.flatnonzero(self._ties))
        return VCycle.near(
            near, self._hierarchy, self.grid, self._free, self._stiffness
        )

    def apply(self, z: Array) -> Array:
        """PᵀA P z, shape (V,)."""
        out = np.zeros_like(z)
        p, image = np.empty_like(z), np.empty_like(z)
        own = np.empty(len(self._voxels))
        self._operate(own, z[self._voxels], p, image)
        out[self._voxels] = own
        return out

    def _operate(self, out: Array, z: Array, p: Array, image: Array) -> None:
        """PᵀA P z of unknowns, shape (n,), with two vectors (V,) to work in."""
        _spread(p, z, self._unknown)
        double.operate(image, p, self._free, *self._conductances, self.grid.shape)
        _gather(out, image, self._unknown)

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
        r, answer = rhs[self._voxels], np.zeros_like(rhs)
        size = math.sqrt(_dot(r, r))
        if size == 0.0:
            return MultigridResult(answer, 0, 0.0)
        r /= size  # single precision takes it as it is
        x, z, direction, image = (np.zeros_like(r) for _ in range(4))
        p, work = np.empty_like(rhs), np.empty_like(rhs)
        b, length, before = self._cycle.b, 0.0, math.inf
        b[self._places] = r
        for iteration in range(1, max_iterations + 1):
            self._cycle.run()
            now, along = _take(z, self._cycle.x, self._places, r, image)
            # Polak and Ribière's β: the V-cycle is symmetric to single precision only,
            # and z · r_old = z · (r + length image)
            _turn(direction, z, -length * along / before)
            before = now
            self._operate(image, direction, p, work)
            length = now / _dot(direction, image)
            left = math.sqrt(_step(x, r, direction, image, length, b, self._places))
            if left <= rtol:
                answer[self._voxels] = size * x
                return MultigridResult(answer, iteration, left)
        raise NumericalError(
            f"multigrid reached a relative residual of {left:.1e} in "
            f"{max_iterations} cycles where {rtol:.1e} was asked for"
        )


def _unknown(free: Mask, ties: Mask, representative: Mask, stride: int) -> Index:
    """The number of the unknown of each free voxel, -1 at others, (V,)."""
    n = len(free)
    head = np.arange(n)
    for start in range(stride, n, stride):  # a layer takes over what it is tied to
        own, inner = slice(start, start + stride), slice(start - stride, start)
        head[own] = np.where(ties[inner], head[inner], head[own])
    number = np.full(n, -1, dtype=np.int32)
    number[head[representative]] = np.arange(np.count_nonzero(representative))
    return np.where(free, number[head], np.int32(-1))
