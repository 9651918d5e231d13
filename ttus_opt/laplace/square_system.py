"""Solves with a square L through its symmetric block A on the free voxels.

With the voxels ordered fixed, then free, and rows of free voxels scaled by -r,

    L = [ I   0 ]        p_free = A⁻¹ (r (C p_fixed - g_free)),   A = -diag(r) F.
        [ C   F ],

`LaplaceSystem` is the plain case; the dual solver reduces it to working sets.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.arrays import Array
from ttus_opt.multigrid import MultigridResult

#: Relative residual of solves with A; fields then agree to about 1e-11
RTOL = 1e-12


class RoughCycle(Protocol):
    """Preconditioner of A, as `VCycle`; A need not be symmetric."""

    @property
    def free(self) -> NDArray[np.bool_]:
        """Unknown voxels that it knows of."""

    @property
    def b(self) -> NDArray[np.float32]:
        """Right-hand side, to be written to."""

    @property
    def x(self) -> NDArray[np.float32]:
        """Answer of the last run."""

    def places(self, voxels: NDArray[np.integer]) -> NDArray[np.int64]:
        """Where free voxels lie in both."""

    def run(self) -> None:
        """Set x to an approximation of A⁻¹ b."""

    def run_adjoint(self) -> None:
        """Set x to an approximation of A⁻ᵀ b."""


class Block(Protocol):
    """The square block A of L on free voxels."""

    def rough(self, near: NDArray[np.integer]) -> RoughCycle:
        """A preconditioner that need only be good near some voxels."""


class BlockSolver(Block, Protocol):
    """A solver of a symmetric block A."""

    def solve(self, rhs: Array, *, rtol: float) -> MultigridResult:
        """Its answer to one right-hand side."""


class SquareSystem(Protocol):
    """A square L, and solves with it and its adjoint.

    A voxel is free, or has an identity row (Dirichlet), or has neither row nor column;
    right-hand sides are zero at the last kind.
    """

    @property
    def free(self) -> NDArray[np.bool_]:
        """Voxels with an unknown of their own, shape (V,)."""

    @property
    def radii(self) -> Array:
        """Factors r: A is the free block of -diag(r) L, shape (V,) [m]."""

    @property
    def coupling(self) -> tuple[sp.csr_array, sp.csr_array]:
        """Entries of L in free rows and fixed columns, and their adjoint, (V, V)."""

    @property
    def multigrid(self) -> Block:
        """The block A."""

    def solve(self, right_side: Array, *, rtol: float = RTOL) -> Array:
        """Solve L p = g."""

    def solve_adjoint(self, right_side: Array, *, rtol: float = RTOL) -> Array:
        """Solve Lᵀ q = g."""


class SymmetricSystem(SquareSystem, Protocol):
    """A `SquareSystem` whose block A is symmetric."""

    @property
    def multigrid(self) -> BlockSolver:
        """Solver of A."""


class BlockSolves:
    """The solves of a `SymmetricSystem`."""

    def solve(self: SymmetricSystem, right_side: Array, *, rtol: float = RTOL) -> Array:
        """Solve L p = g.

        Args:
            right_side: g, shape (V,).
            rtol: Relative residual of the symmetric block.

        Returns:
            p, shape (V,).

        Raises:
            NumericalError: The residual was not reached.
        """
        p = np.where(self.free, 0.0, right_side)
        rest = self.radii * (self.coupling[0] @ p - right_side)
        rest[~self.free] = 0.0
        p += self.multigrid.solve(rest, rtol=rtol).x
        return p

    def solve_adjoint(
        self: SymmetricSystem, right_side: Array, *, rtol: float = RTOL
    ) -> Array:
        """Solve Lᵀ q = g; arguments as `solve`."""
        rest = np.where(self.free, -right_side, 0.0)
        q = self.radii * self.multigrid.solve(rest, rtol=rtol).x
        # the adjoint of the identity rows: what flows from free to fixed voxels
        return np.where(self.free, q, right_side - self.coupling[1] @ q)
