"""Laplace's equation in cylindrical coordinates on the voxmap: L p = b (paper eq. 8).

    ∇²p = p_rr + p_r/r + p_θθ/r² + p_zz = 0

Central differences, every row multiplied by Δr², so that rows are dimensionless: for a
voxel in layer r

    (1 - Δr/2r) p(r-Δr) + (1 + Δr/2r) p(r+Δr) - 2 p
        + (Δr / rΔθ)² (p(θ-Δθ) + p(θ+Δθ) - 2 p)
        + (Δr / Δz)² (p(z-Δz) + p(z+Δz) - 2 p) = 0.

Dirichlet voxels have identity rows: +p_in on the inner layer, -p_out on the outer
layer, 0 on the surface layer, and at both ends the solution of the same problem in
polar coordinates. Links to the surface layer have the conductance of their part up to
the surface (`ttus_opt.voxmap.cut_links`), unless the voxmap is a staircase. With the
free rows scaled by -r, their square block A is symmetric positive definite.

Variants: conductivities k_r, k_θ, k_z in front of the three parts, and screening,
∇²p - κ²p.

With the voxels ordered fixed, then free, and rows of free voxels scaled by -r,

    L = [ I   0 ]        p_free = A⁻¹ (r (C p_fixed - g_free)),   A = -diag(r) F.
        [ C   F ],

`BlockSolves` solves with such an L, whose A need not be symmetric: the dual solver has
variants for working sets and for pairs of fields.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.core.arguments import expect_not_negative
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.laplace.multigrid import Added, Grounds, Multigrid, MultigridResult
from ttus_opt.laplace.stencil import (
    Stencil,
    VariantGrid,
    change_links,
    operator,
    polar_ends,
)
from ttus_opt.voxmap.grid import CylindricalGrid
from ttus_opt.voxmap.voxmap import Voxmap

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


@dataclass(frozen=True)
class BlockSystem(BlockSolves):
    """A square L by its parts, as `SquareSystem`.

    Attributes:
        free: Voxels with their own unknown, shape (V,).
        radii: Factors from rows of L to rows of -A, shape (V,) [m].
        coupling: L's entries from fixed voxels to free rows, and their adjoint.
        multigrid: Solver of the block A.
    """

    free: NDArray[np.bool_] = field(repr=False)
    radii: Array = field(repr=False)
    coupling: tuple[sp.csr_array, sp.csr_array] = field(repr=False)
    multigrid: Block = field(repr=False)


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
        """Assemble L and both parts of b.

        Args:
            voxmap: Grid and regions.
            conductivities: k_r, k_θ, k_z; only their ratios matter [–].
            screening: κ of ∇²p - κ²p [1/m].

        Raises:
            InputError: A conductivity that is not positive, a negative κ.
        """
        _check_variant(conductivities, screening)
        grid = voxmap.grid
        fixed = voxmap.dirichlet
        stencil = Stencil.of(grid, conductivities, screening)
        L = operator(grid, fixed, stencil)
        links = voxmap.cut_links
        change = (links.factors - 1.0) * stencil.of_links(links, grid.shape)
        change_links(links.voxels, links.neighbours, change, L)
        inner = np.zeros(grid.shape)
        outer = np.zeros(grid.shape)
        inner[0] = 1.0
        outer[-1] = -1.0
        own = np.where(links.axes == 2, 0.0, change)
        own = grid.unflatten(
            np.bincount(links.voxels, own, grid.n_voxels).astype(float)
        )
        for k in (0, -1):
            inner[:, :, k], outer[:, :, k] = polar_ends(
                grid, voxmap.region[:, :, k], stencil, own[:, :, k]
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

    def for_solves(self) -> LaplaceSystem:
        """The system without L, half of its memory: `solve` reads the coupling only."""
        lean = replace(self, L=sp.csr_array(self.L.shape))
        lean.__dict__["coupling"] = self.coupling  # before L is let go
        return lean

    @cached_property
    def operator_grid(self) -> CylindricalGrid:
        """The grid on which the unscreened operator is k_r times the plain one."""
        grid, (k_r, k_theta, k_z) = self.grid, self.conductivities
        if k_r == k_theta == k_z:
            return grid
        limits = grid.r_inner, grid.r_outer, grid.z_min, grid.z_max
        stretches = np.sqrt(k_r / k_theta), np.sqrt(k_r / k_z)
        return VariantGrid(*limits, grid.shape, grid.sector, *map(float, stretches))

    @cached_property
    def radii(self) -> Array:
        """Factors from free rows of -L to rows of A, r/k_r, shape (V,) [m]."""
        shape = self.grid.shape
        return np.repeat(self.grid.r / self.conductivities[0], shape[1] * shape[2])

    @cached_property
    def multigrid(self) -> Multigrid:
        """Solver of the symmetric block A on the free voxels."""
        grid = self.operator_grid
        return Multigrid(grid, grid.unflatten(self.free), added=self.added)

    @cached_property
    def added(self) -> Added | None:
        """What screening and cut links add to A; None for nothing."""
        grid, grounds, screening = self.grid, self.grounds, None
        if self.screening:
            squared = (self.screening * grid.r_step) ** 2
            layers = grid.r / self.conductivities[0] * squared
            screening = np.broadcast_to(layers[:, None, None], grid.shape)
        if screening is None and grounds is None:
            return None
        return Added(screening, grounds=grounds)

    @cached_property
    def grounds(self) -> Grounds | None:
        """Changes of A by cut links; None where none is cut."""
        grid, links = self.grid, self.voxmap.cut_links
        if not len(links.voxels):
            return None
        stencil = Stencil.of(grid, self.conductivities, self.screening)
        change = (links.factors - 1.0) * stencil.of_links(links, grid.shape)
        change *= self.radii[links.voxels]
        voxels, which = np.unique(links.voxels, return_inverse=True)
        changes = np.zeros((len(voxels), 3))
        np.add.at(changes, (which, links.axes), change)
        free = self.free[voxels]
        return Grounds(voxels[free], changes[free])

    def variant(
        self,
        *,
        conductivities: tuple[float, float, float] = (1.0, 1.0, 1.0),
        screening: float = 0.0,
    ) -> LaplaceSystem:
        """Another operator on the same voxmap, assembled once; as `assemble`."""
        key = (*conductivities, screening)
        if key not in self._variants:
            self._variants[key] = LaplaceSystem.assemble(
                self.voxmap, conductivities=conductivities, screening=screening
            )
        return self._variants[key]

    @cached_property
    def _variants(self) -> dict[tuple[float, ...], LaplaceSystem]:
        return {}

    @cached_property
    def coupling(self) -> tuple[sp.csr_array, sp.csr_array]:
        """Entries of L in free rows and fixed columns, and their adjoint, (V, V)."""
        starts, columns = self.L.indptr, self.L.indices
        keep = ~self.free[columns]
        keep[starts[:-1][~self.free]] = False  # identity rows
        at = np.flatnonzero(keep)
        counts = np.zeros(len(starts), starts.dtype)
        rows = np.searchsorted(starts, at, side="right")  # one beyond
        np.add.at(counts, rows, 1)
        parts = (self.L.data[at], columns[at], np.cumsum(counts, dtype=starts.dtype))
        coupling = sp.csr_array(parts, shape=self.L.shape)
        return coupling, sp.csr_array(coupling.T)


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
    expect_not_negative(screening, "screening", "1/m")
