"""The block A of two fields' Laplace operators, solved as one.

Vectors have 2V entries, the first field before the second, on the same grid. Each field
has its own free voxels. Rows of the second may contain unknowns of the first that
represent both fields (`pair_subproblem`), never the other way round. The block A is
therefore triangular, and a solve takes one with each field's A:

    [A₁    ]
    [X   A₂]
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.laplace.multigrid import Multigrid, MultigridResult, VCycle


class PairCycle:
    """`VCycle` of both fields: one V-cycle of each.

    Attributes:
        b: Right-hand side, the first field before the second.
        x: Answer of the last run, likewise.
        free: Free voxels in its box, shape (2V,).
    """

    def __init__(self, first: VCycle, second: VCycle, across: sp.csr_array) -> None:
        """Allocate scratch arrays.

        Args:
            first: V-cycle of the first field.
            second: V-cycle of the second field.
            across: X over whole grids, shape (V, V).
        """
        self._first, self._second, self._half = first, second, across.shape[0]
        self.b = np.zeros(first.b.size + second.b.size, first.b.dtype)
        self.x = np.zeros_like(self.b)
        self.free = np.concatenate([first.free, second.free])
        left = np.bincount(across.indices, minlength=self._half)
        rows = np.flatnonzero((np.diff(across.indptr) > 0) & second.free)
        columns = np.flatnonzero((left > 0) & first.free)
        self._across = across[rows][:, columns].astype(np.float32)
        self._adjoint = sp.csr_array(self._across.T)
        self._to, self._from = second.places(rows), first.places(columns)

    def places(self, voxels: NDArray[np.integer]) -> NDArray[np.int64]:
        """Indices of free voxels of either field in ``b`` and ``x``."""
        half = self._half
        own = voxels < half
        at = np.empty(len(voxels), dtype=np.int64)
        at[own] = self._first.places(voxels[own])
        at[~own] = self._second.places(voxels[~own] - half) + self._first.b.size
        return at

    def run(self) -> None:
        """Set ``x`` to an approximation of A⁻¹ b."""
        n, first, second = self._first.b.size, self._first, self._second
        first.b[:], second.b[:] = self.b[:n], self.b[n:]
        first.run()
        second.b[self._to] -= self._across @ first.x[self._from]
        second.run()
        self.x[:n], self.x[n:] = first.x, second.x

    def run_adjoint(self) -> None:
        """Set ``x`` to an approximation of A⁻ᵀ b."""
        n, first, second = self._first.b.size, self._first, self._second
        first.b[:], second.b[:] = self.b[:n], self.b[n:]
        second.run()
        first.b[self._from] -= self._adjoint @ second.x[self._to]
        first.run()
        self.x[:n], self.x[n:] = first.x, second.x


@dataclass(frozen=True)
class PairBlock:
    """The block A of both fields.

    Attributes:
        first: Solver of A₁.
        second: Solver of A₂.
        across: X, shape (V, V).
    """

    first: Multigrid
    second: Multigrid
    across: sp.csr_array = field(repr=False)

    @cached_property
    def _adjoint(self) -> sp.csr_array:
        return sp.csr_array(self.across.T)

    def solve(self, rhs: Array, *, rtol: float) -> MultigridResult:
        """A⁻¹ b, shape (2V,)."""
        b, c = np.split(rhs, 2)
        x = self.first.solve(b, rtol=rtol)
        return _both(x, self.second.solve(c - self.across @ x.x, rtol=rtol))

    def solve_adjoint(self, rhs: Array, *, rtol: float) -> MultigridResult:
        """A⁻ᵀ b, shape (2V,)."""
        b, c = np.split(rhs, 2)
        y = self.second.solve(c, rtol=rtol)
        return _both(self.first.solve(b - self._adjoint @ y.x, rtol=rtol), y)

    def preconditioner(self, near: NDArray[np.integer]) -> PairCycle:
        """One V-cycle, in a box around some voxels of either field."""
        places = np.unique(near % self.across.shape[0])
        first, second = (m.preconditioner(places) for m in (self.first, self.second))
        return PairCycle(first, second, self.across)


def _both(x: MultigridResult, y: MultigridResult) -> MultigridResult:
    """The answers of both fields as one."""
    worse = max(x.relative_residual, y.relative_residual)
    return MultigridResult(
        np.concatenate([x.x, y.x]), x.iterations + y.iterations, worse
    )
