"""Geometric multigrid for Laplace's equation on the voxel grid.

On the free voxels of a cylindrical grid, A is r times the negative stencil of
`laplace`: symmetric positive definite. A solve is iterative refinement (`refinement`):
residuals and x in double precision, each correction by conjugate gradients in single
precision (`pcg`), preconditioned by a V-cycle (`workspace`) with red-black zebra line
relaxation (`line_smoother`) on levels that keep the surface closed (`coarsening`).

With pooled blocks (`pooled_blocks`) the operator is PᵀA P. Blocks lie in radial lines,
which the smoother solves exactly; links within a block are so strong that, in single
precision, both ends have the same value. All that is left is to sum residuals over
blocks.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arguments import expect_shape
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError, NumericalError
from ttus_opt.core.threads import in_parts, parts_of
from ttus_opt.laplace.multigrid import refinement
from ttus_opt.laplace.multigrid.coarsening import Added, conductances
from ttus_opt.laplace.multigrid.hierarchy import Hierarchy
from ttus_opt.laplace.multigrid.pcg import Vectors
from ttus_opt.laplace.multigrid.pooled_blocks import PooledBlocks
from ttus_opt.laplace.multigrid.subdomain import Subdomain
from ttus_opt.laplace.multigrid.v_cycle import VCycle
from ttus_opt.laplace.multigrid.workspace import LARGE
from ttus_opt.voxmap.grid import CylindricalGrid

#: Sweeps of `OneCycle` before and after on the finest level [–]: on M, 49 steps of
#: conjugate gradients with one sweep are 16 with two
SWEEPS = 2
#: Factor of the residual after one correction: the limit of single precision [–]
REDUCTION = 1e-4
#: Right-hand sides between its inverse and this are not rescaled.
MODERATE = 1e100
#: Consecutive corrections that may fail to halve the residual, and most V-cycles [–]
PATIENCE, MOST_CYCLES = 3, 500


@dataclass(frozen=True)
class MultigridResult:
    """Answer of one solve.

    Attributes:
        x: Solution, zero at fixed voxels, shape (V,).
        iterations: V-cycles spent on it [–].
        relative_residual: ‖b - A x‖ / ‖b‖, in double precision [–].
    """

    x: Array = field(repr=False)
    iterations: int
    relative_residual: float


class Multigrid:
    """Solver of A x = b on the free voxels of a grid.

    (A x)_v = r_i · Σ c (x_v - x_neighbour) over the six neighbours, with the weights
    c of `laplace` and x = 0 at fixed voxels; b and x are full vectors (V,), zero at
    fixed voxels and at followers of blocks. What is added to the operator is constant
    within each layer, cut links aside.

    An instance may be used by several threads at once: each call works in arrays of
    its own, and compiled code releases the interpreter's lock. A solve on a large grid
    uses all cores (`workspace`). Equal calls give equal bits.

    Attributes:
        grid: The grid.
        free: Unknown voxels, shape (V,).
        blocks: Pooled voxels; None for none.
        added: What is added to the operator of the grid; None for nothing.
        hierarchy: The levels.
        norm_bound: Bound of its norm (Gershgorin), without links that are added [m].
    """

    def __init__(
        self,
        grid: CylindricalGrid,
        free: NDArray[np.bool_],
        *,
        blocks: PooledBlocks | None = None,
        added: Added | None = None,
    ) -> None:
        """Build the levels, which costs about as much as one solve.

        Args:
            grid: The grid.
            free: Unknown voxels, shape ``grid.shape``; none in the first and last
                layer and slice.
            blocks: As above.
            added: As above.

        Raises:
            InputError: The mask has another shape, or frees a voxel on the rim.
        """
        free = np.ascontiguousarray(free)
        if free.shape != grid.shape or free.dtype != np.bool_:
            raise InputError(
                f"free must be a boolean array of shape {grid.shape}, got "
                f"{free.dtype} {free.shape}"
            )
        if free[[0, -1]].any() or free[:, :, [0, -1]].any():
            raise InputError(
                "free voxels in the first or last layer or slice, which have no "
                "neighbour beyond: mark them False"
            )
        self.grid, self.free = grid, grid.flatten(free)
        self.blocks, self.added = blocks, added
        pooled = None if blocks is None else grid.unflatten(blocks.pooled)
        self.hierarchy = Hierarchy.build(grid, free, pooled, added)
        added = added or Added()
        r, t, z = steps = conductances(grid)
        own = np.zeros_like(r)
        if added.screening is not None:
            own = np.ascontiguousarray(added.screening[:, 0, 0])
        self.norm_bound = float(
            np.max(2.0 * (r + np.roll(r, 1) + 2.0 * t + 2.0 * z) + own)
        )
        if added.grounds is not None:
            changes = added.grounds.changes.sum(axis=1)
            self.norm_bound += float(changes.max(initial=0.0))
        if blocks is not None:
            self.norm_bound *= math.sqrt(blocks.longest)
        self._operator = refinement.Operator.of(
            self.free, steps, self._sizes, own, added.grounds
        )
        self._idle: deque[Vectors] = deque()
        self._parts = parts_of(self.free.size, LARGE)

    def __reduce__(self) -> tuple[Callable[..., Multigrid], tuple[object, ...]]:
        """Pickle as what it was built from."""
        make = partial(type(self), blocks=self.blocks, added=self.added)
        return make, (self.grid, self.grid.unflatten(self.free))

    @property
    def _sizes(self) -> tuple[int, int, int]:
        """Spokes, slices and the pitch of the red-black order [–]."""
        _, n_theta, n_z = self.grid.shape
        return n_theta, n_z, self.hierarchy.levels[0].layout.pitch

    def preconditioner(self, near: NDArray[np.integer] | None = None) -> VCycle:
        """A preconditioner of one V-cycle, with arrays of its own and without copies.

        Args:
            near: Flat indices of the voxels where it must be accurate, shape (k,): it
                may cover only a box around them. None for all voxels.
        """
        levels, sweeps = self.hierarchy, 1 if near is None else 2
        if near is not None and self.blocks is not None:
            # all blocks, because one that is cut would be held fixed
            near = np.union1d(near, np.flatnonzero(self.blocks.pooled))
        part = Subdomain.around(self.grid, near)
        if not part.is_whole:
            place, boxes = (part.first, part.shape), levels.boxes
            if place not in boxes:
                boxes.clear()
                boxes[place] = self._levels_of(part)
            levels = boxes[place]
        return VCycle(levels, part, self.free, sweeps=sweeps)

    def _levels_of(self, part: Subdomain) -> Hierarchy:
        """The levels of a part of the grid."""
        pooled = None
        if self.blocks is not None:
            pooled = part.restrict(self.grid.unflatten(self.blocks.pooled))
        added = None if self.added is None else self.added.within(part)
        free = part.free(self.grid.unflatten(self.free))
        return Hierarchy.build(part, free, pooled, added)

    def solve_adjoint(self, rhs: Array, *, rtol: float) -> MultigridResult:
        """Solve Aᵀ x = b: the same, as A is symmetric."""
        return self.solve(rhs, rtol=rtol)

    def _taken(self) -> Vectors:
        """Scratch arrays that no other thread has."""
        try:
            return self._idle.pop()
        except IndexError:
            return Vectors(self.hierarchy, self.blocks)

    def solve(self, rhs: Array, *, rtol: float = 1e-12) -> MultigridResult:
        """Solve A x = b.

        It ends when ‖b - A x‖ ≤ rtol ‖b‖, or when the residual is down to rounding:
        ‖b - A x‖ ≤ ε (‖A‖ ‖x‖ + ‖b‖) with ε = 2.2e-16 and a bound for ‖A‖. The
        result states the residual that was reached.

        Args:
            rhs: b, shape (V,); values at fixed voxels are left out.
            rtol: Relative residual asked for; 0 for what rounding allows [–].

        Returns:
            Solution, V-cycles and relative residual.

        Raises:
            InputError: b has another shape or is not finite, or rtol is negative.
            NumericalError: The residual was not reached.
        """
        assert self.added is None or not self.added.links, "for one cycle only"
        if not 0.0 <= rtol < 1.0:
            raise InputError(f"rtol must be at least 0 and below 1, got {rtol}")
        b, largest = self._vector(rhs)
        if largest == 0.0:
            return MultigridResult(b, 0, 0.0)
        unit = math.ldexp(1.0, math.frexp(largest)[1] - 1)
        if 1.0 / MODERATE < largest < MODERATE:
            return self._refine(b, rtol, 1.0 / unit)
        b /= unit  # squares neither overflow nor vanish
        result = self._refine(b, rtol)
        return replace(result, x=result.x * unit)

    def _refine(self, b: Array, rtol: float, scale: float = 1.0) -> MultigridResult:
        """Iterative refinement for a right-hand side whose squares are numbers.

        Args:
            b: Right-hand side, zero at fixed voxels, shape (V,).
            rtol: As in `solve`.
            scale: What brings b near 1, for single precision [–].
        """
        work = self._taken()
        now = size = self._residual(work, None, b, scale)
        x, norm_x = np.zeros_like(b), 0.0
        iterations, failures = 0, 0
        while True:
            floor = np.finfo(float).eps * (self.norm_bound * norm_x + size)
            target = max(rtol * size, floor)
            if now <= target:
                break
            if failures == PATIENCE or iterations >= MOST_CYCLES:
                raise NumericalError(
                    f"multigrid reached a relative residual of {now / size:.1e} after "
                    f"{iterations} cycles, {rtol:.1e} was requested: allow a larger "
                    "rtol"
                )
            goal = max(REDUCTION, 0.5 * target / now)
            iterations += work.correct(goal, MOST_CYCLES - iterations)
            part = work.answer, 1.0 / scale, self._operator
            norm_x = math.sqrt(refinement.add(x, *part, parts=self._parts))
            before, scale = now, 1.0 / now
            now = self._residual(work, x, b, scale)
            failures = failures + 1 if now > 0.5 * before else 0
        self._idle.append(work)
        if self.blocks is not None:
            x[self.blocks.followers] = 0.0
        return MultigridResult(x, iterations, now / size)

    def _vector(self, values: Array) -> tuple[Array, float]:
        """A copy with zeros at fixed voxels, and its largest absolute value.

        Raises:
            InputError: It is not such a vector.
        """
        vector = np.asarray(values, dtype=float)
        expect_shape(vector, self.free.shape, "the right-hand side")
        kept = np.where(self.free, vector, 0.0)
        if self.blocks is not None:
            kept[self.blocks.followers] = 0.0
        largest = max(float(kept.max()), -float(kept.min()))
        if not math.isfinite(largest):
            raise InputError(
                "the right-hand side must be finite at free voxels, got NaN or inf"
            )
        return kept, largest

    def _residual(
        self, work: Vectors, x: Array | None, b: Array, scale: float
    ) -> float:
        """‖b - A x‖, x zero if None; leaves it scaled in ``work.b``."""
        if x is not None and self.blocks is not None:
            self.blocks.prolong(x)
            b = b - self._product(x)
            self.blocks.restrict(b)
            x = None
        given = b if x is None else x
        args = work.b, given, b, self._operator, scale
        square = refinement.residual(*args, is_zero=x is None, parts=self._parts)
        return math.sqrt(square)

    def _product(self, x: Array) -> Array:
        """A x for a vector that is zero at fixed voxels."""
        out = np.zeros_like(x)
        in_parts(partial(refinement.operate, out, x, self._operator), self._parts)
        return out


class OneCycle(Multigrid):
    """A⁻¹ approximated by one V-cycle; any links may be added to the operator.

    The map b ↦ x is linear, symmetric and positive definite up to single precision, as
    a preconditioner must be. With several sweeps on the finest level it is close to A⁻¹
    in the Euclidean norm and not only in the energy norm: two such maps in a row are
    then spectrally equivalent to A⁻².
    """

    def solve(self, rhs: Array, *, rtol: float = 0.0) -> MultigridResult:
        """One V-cycle's answer.

        Args:
            rhs: b, shape (V,); values at fixed voxels are left out.
            rtol: Ignored: the accuracy of one V-cycle is fixed.

        Returns:
            The answer after one cycle; its residual is not computed.
        """
        x = np.zeros_like(rhs)
        most, least = (f(where=self.free, initial=0.0) for f in (rhs.max, rhs.min))
        largest = max(float(most), -float(least))
        if largest > 0.0:
            work, order = self._taken(), self._operator
            refinement.residual(work.b, rhs, rhs, order, 1.0 / largest, is_zero=True)
            work.v_cycle(sweeps=SWEEPS)
            refinement.add(x, work.x, largest, order)
            self._idle.append(work)
        if self.blocks is not None:
            x[self.blocks.followers] = 0.0
        return MultigridResult(x, 1, np.nan)
