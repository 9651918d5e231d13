"""Laplace's equation on the voxmap: L p = b (paper eq. 8; design §3).

Central differences of ∇²p = p_r/r + p_rr + p_θθ/r² + p_zz, every row multiplied by
Δr², so that rows are dimensionless stencils. Voxels with a given value are identity
rows: +p_in on the inner layer, -p_out on the outer layer, 0 on the surface layer,
and at both ends the solution of the same problem in polar coordinates. With the
free rows scaled by -r, their square block is symmetric positive definite (A).

Variants: conductivities k_r, k_θ, k_z in front of the three parts, and screening,
∇²p - κ²p. Only the plain operator has a multigrid.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from ttus_opt.arrays import Array
from ttus_opt.compiled import compiled
from ttus_opt.errors import InputError
from ttus_opt.multigrid import Multigrid, MultigridResult
from ttus_opt.voxmap.grid import CylindricalGrid, flat_index
from ttus_opt.voxmap.voxmap import Voxmap

#: Relative residual to which `LaplaceSystem` solves; fields agree to about 1e-11
RTOL = 1e-12


class RoughCycle(Protocol):
    """A⁻¹ roughly, as `VCycle`; the block A need not be symmetric."""

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
        """Set x to A⁻¹ b."""

    def run_adjoint(self) -> None:
        """Set x to A⁻ᵀ b."""


class Block(Protocol):
    """The square block A on free voxels."""

    def rough(self, near: NDArray[np.integer]) -> RoughCycle:
        """One V-cycle at a time, of use near some voxels."""


class BlockSolver(Block, Protocol):
    """A solver of a symmetric block A."""

    def solve(self, rhs: Array, *, rtol: float) -> MultigridResult:
        """Its answer to one right-hand side."""


class SquareSystem(Protocol):
    """L of some problem: what solves with it need, and the solves.

    Voxels are free, or fixed with an identity row, or take no part: these have no
    row and no column, and right-hand sides are zero there.
    """

    @property
    def free(self) -> NDArray[np.bool_]:
        """Voxels with an unknown of their own, shape (V,)."""

    @property
    def radii(self) -> Array:
        """What turns a row of A into minus one of L, shape (V,) [m]."""

    @property
    def coupling(self) -> tuple[sp.csr_array, sp.csr_array]:
        """L's entries from fixed voxels to free rows, and their adjoint, (V, V)."""

    @property
    def multigrid(self) -> Block:
        """What A is on the free voxels."""

    def solve(self, right_side: Array, *, rtol: float = RTOL) -> Array:
        """Solve L p = g."""

    def solve_adjoint(self, right_side: Array, *, rtol: float = RTOL) -> Array:
        """Solve Lᵀ q = g."""


class SymmetricSystem(SquareSystem, Protocol):
    """A `SquareSystem` whose block A is symmetric."""

    @property
    def multigrid(self) -> BlockSolver:
        """Solver of A on the free voxels."""


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


@dataclass(frozen=True)
class LaplaceSystem(BlockSolves):
    """L and b of one voxmap, and solves with L and its adjoint.

    b is linear in the boundary values: b = p_in · inner_part + p_out · outer_part.

    Attributes:
        voxmap: Grid and regions.
        L: Laplace operator with identity rows at Dirichlet voxels, (V, V) [–].
        inner_part: b for p_in = 1, p_out = 0, shape (V,) [–].
        outer_part: b for p_in = 0, p_out = 1, shape (V,) [–].
        free: Voxels that are not Dirichlet, shape (V,).
        conductivities: k_r, k_θ, k_z [–].
        screening: κ [1/m].
    """

    voxmap: Voxmap
    L: sp.csr_array = field(repr=False)
    inner_part: Array = field(repr=False)
    outer_part: Array = field(repr=False)
    free: NDArray[np.bool_] = field(repr=False)
    conductivities: tuple[float, float, float] = (1.0, 1.0, 1.0)
    screening: float = 0.0

    @classmethod
    def assemble(
        cls,
        voxmap: Voxmap,
        *,
        conductivities: tuple[float, float, float] = (1.0, 1.0, 1.0),
        screening: float = 0.0,
    ) -> LaplaceSystem:
        """Assemble L and both parts of b, all voxels at once.

        Args:
            voxmap: Grid and regions.
            conductivities: k_r, k_θ, k_z, of which only the ratios matter [–].
            screening: κ of ∇²p - κ²p [1/m].

        Raises:
            InputError: A conductivity that is not positive, a negative κ.
        """
        _check_variant(conductivities, screening)
        grid = voxmap.grid
        fixed = voxmap.dirichlet
        stencil = _coefficients(grid, conductivities, screening)
        indptr, indices, data = _stencil_rows(
            grid.flatten(fixed), *stencil, np.array(grid.shape)
        )
        L = sp.csr_array((data, indices, indptr), shape=(grid.n_voxels,) * 2)
        L.has_sorted_indices = True
        inner = np.zeros(grid.shape)
        outer = np.zeros(grid.shape)
        inner[0] = 1.0
        outer[-1] = -1.0
        for k in (0, -1):
            inner[:, :, k], outer[:, :, k] = _polar_ends(
                grid, voxmap.region[:, :, k], stencil
            )
        for part in (inner, outer):
            part[voxmap.on_surface] = 0.0
        return cls(
            voxmap,
            L,
            grid.flatten(inner),
            grid.flatten(outer),
            ~grid.flatten(fixed),
            conductivities,
            screening,
        )

    @property
    def is_plain(self) -> bool:
        """Whether this is ∇² itself, which the multigrid knows."""
        return self.conductivities == (1.0, 1.0, 1.0) and self.screening == 0.0

    @property
    def grid(self) -> CylindricalGrid:
        """The voxmap's grid."""
        return self.voxmap.grid

    def right_side(self, inner: float, outer: float) -> Array:
        """Boundary vector b for given boundary values.

        Args:
            inner: p_in on the inner layer [N].
            outer: p_out; the outer layer gets -p_out [N].

        Returns:
            b, shape (V,) [N].
        """
        if not (np.isfinite(inner) and np.isfinite(outer)):
            raise InputError(f"boundary values must be finite, got {inner}, {outer}")
        return inner * self.inner_part + outer * self.outer_part

    @cached_property
    def radii(self) -> Array:
        """Radius of every voxel, shape (V,) [m]."""
        shape = self.grid.shape
        return np.repeat(self.grid.r, shape[1] * shape[2])

    @cached_property
    def multigrid(self) -> Multigrid:
        """Solver of the symmetric block A on the free voxels.

        Raises:
            InputError: The operator is a variant, for which there is none.
        """
        if not self.is_plain:
            raise InputError(
                "the multigrid solves the plain Laplace operator only: fit the variant "
                "with a solver that factorises"
            )
        return Multigrid(self.grid, self.grid.unflatten(self.free))

    @cached_property
    def coupling(self) -> tuple[sp.csr_array, sp.csr_array]:
        """L's entries from fixed voxels to free rows, and their adjoint, (V, V)."""
        row = np.repeat(np.arange(self.L.shape[0]), np.diff(self.L.indptr))
        keep = self.free[row] & ~self.free[self.L.indices]
        entries = (self.L.data[keep], (row[keep], self.L.indices[keep]))
        coupling = sp.csr_array(entries, shape=self.L.shape)
        return coupling, sp.csr_array(coupling.T)


_Stencil = tuple[Array, Array, Array, float, float]


def _check_variant(
    conductivities: tuple[float, float, float], screening: float
) -> None:
    if len(conductivities) != 3 or not all(
        np.isfinite(k) and k > 0.0 for k in conductivities
    ):
        raise InputError(
            f"conductivities must be three positive numbers k_r, k_θ, k_z, got "
            f"{conductivities}"
        )
    if not (np.isfinite(screening) and screening >= 0.0):
        raise InputError(f"screening must not be negative [1/m], got {screening}")


def _coefficients(
    grid: CylindricalGrid,
    conductivities: tuple[float, float, float] = (1.0, 1.0, 1.0),
    screening: float = 0.0,
) -> _Stencil:
    """Stencil weights per layer: towards -r, +r, θ, the ones of z and of p itself [–].

    Scaled so that the radial weights of the plain operator stay 1 ∓ Δr/2r.
    """
    r = grid.r
    k_r, k_theta, k_z = conductivities
    half = grid.r_step / (2.0 * r)
    c_theta = k_theta * (grid.r_step / (r * grid.theta_step)) ** 2
    c_z = k_z * (grid.r_step / grid.z_step) ** 2
    return (
        k_r * (1.0 - half),
        k_r * (1.0 + half),
        c_theta,
        c_z,
        (screening * grid.r_step) ** 2,
    )


@compiled()
def _stencil_rows(
    fixed: NDArray[np.bool_],
    c_minus: Array,
    c_plus: Array,
    c_theta: Array,
    c_z: float,
    c_self: float,
    shape: NDArray[np.int64],
) -> tuple[NDArray[np.int32], NDArray[np.int32], Array]:
    """Rows of L in CSR with sorted columns (compiled)."""
    n_r, n_theta, n_z = shape
    n = n_r * n_theta * n_z
    n_fixed = 0
    for v in range(n):
        n_fixed += fixed[v]
    nnz = n_fixed + 7 * (n - n_fixed)
    indptr = np.empty(n + 1, dtype=np.int32)
    indices = np.empty(nnz, dtype=np.int32)
    data = np.empty(nnz)
    at = 0
    indptr[0] = 0
    for i in range(n_r):
        diagonal = -(c_minus[i] + c_plus[i] + 2.0 * c_theta[i] + 2.0 * c_z) - c_self
        for j in range(n_theta):
            for k in range(n_z):
                v = flat_index(i, j, k, n_theta, n_z)
                if fixed[v]:
                    indices[at] = v
                    data[at] = 1.0
                    at += 1
                else:
                    before = flat_index(i, (j - 1) % n_theta, k, n_theta, n_z)
                    after = flat_index(i, (j + 1) % n_theta, k, n_theta, n_z)
                    low, high = min(before, after), max(before, after)
                    # columns ascend; at the seam both θ neighbours lie on one side
                    indices[at] = flat_index(i - 1, j, k, n_theta, n_z)
                    data[at] = c_minus[i]
                    if low < v:
                        indices[at + 1] = low
                        data[at + 1] = c_theta[i]
                        at += 1
                    if high < v:
                        indices[at + 1] = high
                        data[at + 1] = c_theta[i]
                        at += 1
                    indices[at + 1] = v - 1
                    data[at + 1] = c_z
                    indices[at + 2] = v
                    data[at + 2] = diagonal
                    indices[at + 3] = v + 1
                    data[at + 3] = c_z
                    at += 3
                    if low > v:
                        indices[at + 1] = low
                        data[at + 1] = c_theta[i]
                        at += 1
                    if high > v:
                        indices[at + 1] = high
                        data[at + 1] = c_theta[i]
                        at += 1
                    indices[at + 1] = flat_index(i + 1, j, k, n_theta, n_z)
                    data[at + 1] = c_plus[i]
                    at += 2
                indptr[v + 1] = at
    return indptr, indices, data


def _polar_ends(
    grid: CylindricalGrid, region: NDArray[np.int8], stencil: _Stencil
) -> tuple[Array, Array]:
    """Polar solutions on one end slice for p_in = 1 and for p_out = 1.

    Args:
        grid: The grid.
        region: Regions of the slice, shape (n_r, n_theta).
        stencil: Weights; the one of z has no part in it.

    Returns:
        Both solutions, shape (n_r, n_theta) each [–].
    """
    n_r, n_theta, _ = grid.shape
    c_minus, c_plus, c_theta, _, c_self = stencil
    fixed = region == 0
    fixed[[0, -1]] = True
    radial = (
        sp.diags_array(c_minus[1:], offsets=-1)
        + sp.diags_array(-(c_minus + c_plus) - c_self)
        + sp.diags_array(c_plus[:-1], offsets=1)
    )
    ring = sp.diags_array(
        [1.0, 1.0, -2.0, 1.0, 1.0],
        offsets=[1 - n_theta, -1, 0, 1, n_theta - 1],
        shape=(n_theta, n_theta),
    )
    full = sp.kron(radial, sp.eye_array(n_theta)) + sp.kron(
        sp.diags_array(c_theta), ring
    )
    at = fixed.reshape(-1)
    M = sp.diags_array((~at).astype(float)) @ full + sp.diags_array(at.astype(float))
    sides = np.zeros((n_r, n_theta, 2))
    sides[0, :, 0] = 1.0
    sides[-1, :, 1] = -1.0
    sides[region == 0] = 0.0
    solved = splu(sp.csc_array(M)).solve(sides.reshape(-1, 2)).reshape(n_r, n_theta, 2)
    return solved[..., 0], solved[..., 1]
