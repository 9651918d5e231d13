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
    n_r, _, n_z = grid.shape
    index = np.arange(grid.n_voxels).reshape(grid.shape)
    shape = grid.shape
    arc = grid.r_step / (grid.r * grid.theta_step)  # [–]
    rows, columns, values = [], [], []
    scales = (
        np.ones(shape),
        np.broadcast_to(arc[:, None, None], shape),
        np.full(shape, grid.r_step / grid.z_step),
    )
    for axis, scale in enumerate(scales):
        after = np.roll(index, -1, axis=axis)
        there = np.ones(shape, dtype=bool)
        if axis == 0:
            there[n_r - 1] = False
        if axis == 1 and grid.wall is not None:
            there[:, grid.wall - 1 :] = False
        if axis == 2:
            there[:, :, n_z - 1] = False
        row = 3 * index[there] + axis
        rows += [row, row]
        columns += [index[there], after[there]]
        values += [-scale[there], scale[there]]
    entries = (
        np.concatenate(values),
        (np.concatenate(rows), np.concatenate(columns)),
    )
    return sp.csr_array(entries, shape=(3 * grid.n_voxels, grid.n_voxels))
