"""Departures from a reference field: Tikhonov's squares, and their total variation.

Total variation penalises differences D (p − p₀) between neighbouring voxels, divided by
their distance in units of Δr. Departures then are plateaus with edges, like a stiff
lump in soft tissue. There are two variants:

- anisotropic (default): Σ of all absolute differences, a quadratic program;
- isotropic: Σ over voxels of the length of (D_r, D_θ, D_z), a cone program.

See docs/method/formulations.md, The shelf and Penalties.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arguments import expect_one_of
from ttus_opt.problem.terms.base import AffineRows, Term
from ttus_opt.problem.terms.penalties import Absolute, Groups, Penalty
from ttus_opt.problem.terms.rows import unit_rows
from ttus_opt.voxmap.grid import CylindricalGrid

REFERENCES = ("laplace", "zero")


@dataclass(frozen=True)
class TikhonovTerm(Term):
    """Squares of the departure from a reference field [unit of p, squared].

    Attributes:
        reference: "laplace" for the Laplace field p₀ = L⁻¹b, or "zero".
    """

    reference: str = "laplace"

    name = "tikhonov"
    formula = "‖p − p_ref‖² over free voxels"

    def __post_init__(self) -> None:
        """Validate weight and reference."""
        super().__post_init__()
        expect_one_of(self.reference, REFERENCES, "tikhonov reference")

    def rows(self) -> AffineRows:
        """Identity rows of the free voxels."""
        scene = self.scene
        free = np.flatnonzero(scene.laplace.free)
        rows = unit_rows(free, scene.n_voxels)
        target = np.zeros(len(free))
        if self.reference == "laplace":
            target = scene.laplace.solve(scene.b)[free]
        return AffineRows({"p": rows}, target)


@dataclass(frozen=True)
class TotalVariationTerm(Term):
    """Absolute differences of p − p₀ between neighbouring voxels.

    Attributes:
        isotropic: Whether the length of a voxel's three differences is penalised
            instead of each absolute value.
    """

    isotropic: bool = False

    name = "total_variation"

    @property
    def formula(self) -> str:
        """The sum of absolute values or of lengths."""
        return "Σ ‖D (p − p₀)‖" if self.isotropic else "Σ |D (p − p₀)|"

    @property
    def penalty(self) -> Penalty:
        """Absolute values, or lengths of groups of three."""
        return Groups(3) if self.isotropic else Absolute()

    def rows(self) -> AffineRows:
        """D and D p₀, rows r, θ, z of each voxel together."""
        D = difference_rows(self.scene.voxmap.grid)
        laplace_field = self.scene.laplace.solve(self.scene.b)
        return AffineRows({"p": D}, D @ laplace_field)


def difference_rows(grid: CylindricalGrid) -> sp.csr_array:
    """Forward differences to the next voxel in r, θ and z over their distance in Δr.

    Args:
        grid: The grid.

    Returns:
        Rows 3v, 3v+1, 3v+2 of voxel v, shape (3V, V) [–]; empty if there is no next
        voxel. θ is periodic, except on a sector.
    """
    n_r, n_theta, n_z = grid.shape
    around = n_theta if grid.wall is None else grid.wall - 1
    arc = grid.r_step / (grid.r * grid.theta_step)  # [–]
    each = (
        sp.kron(_to_the_next(n_r, n_r - 1), sp.eye_array(n_theta * n_z)),
        sp.kron(
            sp.diags_array(arc),
            sp.kron(_to_the_next(n_theta, around), sp.eye_array(n_z)),
        ),
        sp.kron(
            sp.eye_array(n_r * n_theta),
            grid.r_step / grid.z_step * _to_the_next(n_z, n_z - 1),
        ),
    )
    order = np.arange(3 * grid.n_voxels).reshape(3, -1).T.ravel()
    return sp.csr_array(sp.vstack(each, format="csr")[order])


def _to_the_next(n: int, count: int) -> sp.csr_array:
    """Differences to the next of n places in a ring, of the first ``count`` of them."""
    at = np.arange(count)
    entries = np.tile([-1.0, 1.0], count), np.stack([at, (at + 1) % n], axis=1).ravel()
    starts = 2 * np.minimum(np.arange(n + 1), count)
    return sp.csr_array((*entries, starts), shape=(n, n))
