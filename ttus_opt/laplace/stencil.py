"""Rows of the Laplace operator on a grid: seven weights per free voxel.

Weights of the equation in `ttus_opt.laplace.system`, its matrix, the changes by cut
links, and the polar solutions at both ends.

A variant of the operator is the plain one on another grid (`VariantGrid`): with
conductivities k the stencil is k_r times the plain one on a grid whose steps along
θ and z are multiplied by √(k_r/k_θ) and √(k_r/k_z), as these enter only as Δr²/Δθ² and
Δr²/Δz². The multigrid of the plain operator, whose coarsening follows the steps, then
solves the variant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.voxmap.cut_links import CutLinks
from ttus_opt.voxmap.grid import CylindricalGrid, nodes_of

#: A free voxel and its neighbours [–]
NEIGHBOURHOOD = 7


class Stencil(NamedTuple):
    """Weights of a free voxel's neighbours, and the screening of its own.

    Attributes:
        inner: Next layer inwards, shape (n_r,) [–].
        outer: Next layer outwards, shape (n_r,) [–].
        theta: Next spokes, shape (n_r,) [–].
        z: Next slices [–].
        own: (κ Δr)² [–].
    """

    inner: Array
    outer: Array
    theta: Array
    z: float
    own: float

    def of_links(self, links: CutLinks, shape: tuple[int, int, int]) -> Array:
        """The weight of each link without a cut, shape (k,) [–]."""
        i = nodes_of(links.voxels, shape)[0]
        along = np.where(links.neighbours > links.voxels, self.outer[i], self.inner[i])
        return np.choose(links.axes, [along, self.theta[i], self.z])

    @classmethod
    def of(
        cls,
        grid: CylindricalGrid,
        conductivities: tuple[float, float, float],
        screening: float,
    ) -> Stencil:
        """Scaled so that the radial weights of the plain operator are 1 ∓ Δr/2r."""
        r = grid.r
        k_r, k_theta, k_z = conductivities
        half = grid.r_step / (2.0 * r)
        return cls(
            k_r * (1.0 - half),
            k_r * (1.0 + half),
            k_theta * (grid.r_step / (r * grid.theta_step)) ** 2,
            k_z * (grid.r_step / grid.z_step) ** 2,
            (screening * grid.r_step) ** 2,
        )


def operator(
    grid: CylindricalGrid, fixed: NDArray[np.bool_], stencil: Stencil
) -> sp.csr_array:
    """L with sorted columns.

    The seven columns of a free voxel's row ascend in another order on the first and the
    last spoke, where θ wraps around.
    """
    ring, row, one = grid.strides
    turn = ring - row
    inner, outer, theta, z, own = stencil
    along_z = np.full_like(theta, z)
    diagonal = -(inner + outer + 2.0 * theta + 2.0 * z) - own
    middle = (along_z, diagonal, along_z)
    offsets = np.array(
        [
            (-ring, -one, 0, one, row, turn, ring),
            (-ring, -row, -one, 0, one, row, ring),
            (-ring, -turn, -row, -one, 0, one, ring),
        ]
    )
    weights = np.array(
        [
            (inner, *middle, theta, theta, outer),
            (inner, theta, *middle, theta, outer),
            (inner, theta, theta, *middle, outer),
        ]
    )
    V = grid.n_voxels
    nnz = NEIGHBOURHOOD * V - (NEIGHBOURHOOD - 1) * int(np.count_nonzero(fixed))
    kind = np.dtype(np.int32 if nnz <= np.iinfo(np.int32).max else np.int64)
    indptr, indices, data = np.zeros(V + 1, kind), np.empty(nnz, kind), np.empty(nnz)
    np.cumsum(np.where(fixed, 1, NEIGHBOURHOOD), dtype=kind, out=indptr[1:])
    spoke = np.ones(ring // row, np.int64)
    spoke[0], spoke[-1] = 0, 2
    kind_of = np.repeat(spoke, row)
    around = (np.arange(ring)[:, None] + offsets[kind_of]).astype(kind)
    for i, held in enumerate(fixed.reshape(-1, ring)):  # arrays that fit the cache
        at, first = np.flatnonzero(held), i * ring
        columns, values = around + kind.type(first), weights[:, :, i][kind_of]
        columns[at, 0], values[at, 0] = first + at, 1.0
        kept = np.ones(columns.shape, bool)
        kept[at, 1:] = False
        part = slice(indptr[first], indptr[first + ring])
        indices[part], data[part] = columns[kept], values[kept]
    L = sp.csr_array((data, indices, indptr), shape=(V, V))
    L.has_sorted_indices = True
    return L


def change_links(
    voxels: IntArray, neighbours: IntArray, change: Array, L: sp.csr_array
) -> None:
    """Change the weights of links in the rows of L.

    Args:
        voxels: Whose rows, shape (k,); identity rows stay as they are.
        neighbours: The columns, shape (k,).
        change: Added to a link's weight and subtracted from the diagonal, shape (k,).
        L: Changed.
    """
    free = np.diff(L.indptr)[voxels] > 1
    own, change = voxels[free, None], change[free]
    entries = L.indptr[own] + np.arange(NEIGHBOURHOOD)
    columns = L.indices[entries]
    linked = columns == neighbours[free, None]
    # every link has its own entry, while a voxel may have several links
    L.data[entries[linked]] += change
    np.subtract.at(L.data, entries[columns == own], change)


def polar_ends(
    grid: CylindricalGrid, region: NDArray[np.int8], stencil: Stencil, change: Array
) -> tuple[Array, Array]:
    """Polar solutions on one end slice for p_in = 1 and for p_out = 1.

    Args:
        grid: The grid.
        region: Regions of the slice, shape (n_r, n_theta).
        stencil: Weights; that of z is not used.
        change: Subtracted from the diagonal for cut links, shape (n_r, n_theta) [–].

    Returns:
        Both solutions, shape (n_r, n_theta) each [–].
    """
    n_r, n_theta, _ = grid.shape
    inner, outer, theta, _, own = stencil
    fixed = region == 0
    fixed[[0, -1]] = True
    radial = (
        sp.diags_array(inner[1:], offsets=-1)
        + sp.diags_array(-(inner + outer) - own)
        + sp.diags_array(outer[:-1], offsets=1)
    )
    ring = sp.diags_array(
        [1.0, 1.0, -2.0, 1.0, 1.0],
        offsets=[1 - n_theta, -1, 0, 1, n_theta - 1],
        shape=(n_theta, n_theta),
    )
    full = sp.kron(radial, sp.eye_array(n_theta)) + sp.kron(sp.diags_array(theta), ring)
    # the surface value is 0: cut links change the diagonal only
    full = full - sp.diags_array(change.reshape(-1))
    at = fixed.reshape(-1)
    M = sp.diags_array((~at).astype(float)) @ full + sp.diags_array(at.astype(float))
    sides = np.zeros((n_r, n_theta, 2))
    sides[0, :, 0] = 1.0
    sides[-1, :, 1] = -1.0
    sides[region == 0] = 0.0
    solved = splu(sp.csc_array(M)).solve(sides.reshape(-1, 2)).reshape(n_r, n_theta, 2)
    return solved[..., 0], solved[..., 1]


@dataclass(frozen=True)
class VariantGrid(CylindricalGrid):
    """A grid with other steps along θ and z, for operators, not for positions.

    Attributes:
        theta_stretch: Factor of Δθ [–].
        z_stretch: Factor of Δz [–].
    """

    theta_stretch: float = 1.0
    z_stretch: float = 1.0

    @property
    def theta_step(self) -> float:
        """Angular step times its factor [rad]."""
        return super().theta_step * self.theta_stretch

    @property
    def z_step(self) -> float:
        """Step along the axis times its factor [m]."""
        return super().z_step * self.z_stretch
