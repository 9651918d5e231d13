"""Solves with a square L through its block A on the free voxels.

With the voxels ordered fixed, then free, and rows of free voxels scaled by -r,

    L = [ I   0 ]        p_free = A⁻¹ (r (C p_fixed - g_free)),   A = -diag(r) F.
        [ C   F ],

`LaplaceSystem` is the plain case, with a symmetric A; the dual solver has variants for
working sets and for pairs of fields.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.laplace.multigrid import MultigridResult

#: Relative residual of solves with A; fields then agree to about 1e-11
RTOL = 1e-12


class Preconditioner(Protocol):
    """Preconditioner of A, as `VCycle`; A need not be symmetric."""

    @property
    def free(self) -> NDArray[np.bool_]:
        """The unknown voxels that it covers."""

    @property
    def b(self) -> NDArray[np.float32]:
        """Right-hand side, to be written to."""

    @property
    def x(self) -> NDArray[np.float32]:
        """Solution of the last run."""

    def places(self, voxels: NDArray[np.integer]) -> NDArray[np.int64]:
        """Indices of free voxels in b and x."""

    def run(self) -> None:
        """Set x to an approximation of A⁻¹ b."""

    def run_adjoint(self) -> None:
        """Set x to an approximation of A⁻ᵀ b."""


class Block(Protocol):
    """The square block A of L on free voxels."""

    def preconditioner(self, near: NDArray[np.integer]) -> Preconditioner:
        """A preconditioner that need only be accurate near some voxels."""

    def solve(self, rhs: Array, *, rtol: float) -> MultigridResult:
        """Solve A x = b; at fixed voxels b is ignored and x is zero."""

    def solve_adjoint(self, rhs: Array, *, rtol: float) -> MultigridResult:
        """Solve Aᵀ x = b."""


class SquareSystem(Protocol):
    """A square L, and solves with it and its adjoint.

    A voxel is free, or has an identity row (Dirichlet), or has neither row nor column
    and a right-hand side of zero.
    """

    @property
    def free(self) -> NDArray[np.bool_]:
        """Voxels with an unknown, shape (V,)."""

    @property
    def radii(self) -> Array:
        """Factors r: A is the free block of -diag(r) L, shape (V,) [m]."""

    @property
    def coupling(self) -> tuple[sp.csr_array, sp.csr_array]:
        """Entries of L in free rows and fixed columns, and their adjoint, (V, V)."""

    @property
    def multigrid(self) -> Block:
        """Solver of the block A."""

    def solve(self, right_side: Array, *, rtol: float = RTOL) -> Array:
        """Solve L p = g."""

    def solve_adjoint(self, right_side: Array, *, rtol: float = RTOL) -> Array:
        """Solve Lᵀ q = g."""


class BlockSolves:
    """The solves of a `SquareSystem`."""

    def solve(self: SquareSystem, right_side: Array, *, rtol: float = RTOL) -> Array:
        """Solve L p = g.

        Args:
            right_side: g, shape (V,).
            rtol: Relative residual of the block A.

        Returns:
            p, shape (V,).

        Raises:
            NumericalError: The residual was not reached.
        """
        p = np.where(self.free, 0.0, right_side)
        rest = self.coupling[0] @ p
        rest -= right_side
        rest *= self.radii  # ignored at fixed voxels
        p += self.multigrid.solve(rest, rtol=rtol).x
        return p

    def solve_adjoint(
        self: SquareSystem, right_side: Array, *, rtol: float = RTOL
    ) -> Array:
        """Solve Lᵀ q = g; arguments as `solve`."""
        q = self.multigrid.solve_adjoint(-right_side, rtol=rtol).x
        q *= self.radii
        # coupling of free rows to fixed columns, transposed
        at_fixed = self.coupling[1] @ q
        np.subtract(right_side, at_fixed, out=at_fixed)
        np.copyto(q, at_fixed, where=~self.free)
        return np.asarray(q)
