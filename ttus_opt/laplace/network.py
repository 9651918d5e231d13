"""Differences of neighbouring voxels: a network of conductances on the grid.

For such rows Σ MᵀC M, C positive and diagonal, is an operator like L's with other
conductances, so that one V-cycle solves it approximately.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.laplace.multigrid import Added, OneCycle
from ttus_opt.laplace.multigrid.coarsening import conductances
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.voxmap.grid import CylindricalGrid, nodes_of

#: Least part of the diagonal that comes from differences in a network [–]
DIFFERENCES = 0.9


@dataclass(frozen=True)
class NeighbourRows:
    """The rows of a matrix that are differences of neighbours.

    Attributes:
        rows: Their numbers, shape (k,).
        places: Direction times V plus the first of the two voxels, shape (k,).
        squares: Squares of their entries, shape (k,).
    """

    rows: IntArray = field(repr=False)
    places: IntArray = field(repr=False)
    squares: Array = field(repr=False)

    @classmethod
    def of(cls, matrix: sp.csr_array, grid: CylindricalGrid) -> NeighbourRows:
        """Find them."""
        two = np.flatnonzero(np.diff(matrix.indptr) == 2)
        at = matrix.indptr[two][:, None] + np.arange(2)
        columns, values = matrix.indices[at], matrix.data[at]
        one, other = columns.min(axis=1), columns.max(axis=1)
        apart = np.subtract(nodes_of(other, grid.shape), nodes_of(one, grid.shape))
        opposed = values[:, 0] == -values[:, 1]
        places = np.full(len(two), -1)
        for axis in range(3):
            unit = (np.arange(3) == axis)[:, None]
            # across θ = 2π, the first of the two is the last spoke
            closing = (apart == unit * (grid.shape[axis] - 1)).all(axis=0)
            if axis == 1:
                places[opposed & closing] = (
                    axis * grid.n_voxels + other[opposed & closing]
                )
            next_ = opposed & (apart == unit).all(axis=0)
            places[next_] = axis * grid.n_voxels + one[next_]
        found = places >= 0
        return cls(two[found], places[found], values[found, 0] ** 2)

    def links(self, slope: Array, n_voxels: int) -> Array:
        """Conductances to the next voxel in r, θ and z, shape (3, V).

        Args:
            slope: Diagonal of C over all rows, shape (m,).
            n_voxels: V.
        """
        strength = self.squares * slope[self.rows]
        summed = np.bincount(self.places, strength, 3 * n_voxels)
        return np.asarray(summed.reshape(3, n_voxels))


def by_network(
    laplace: LaplaceSystem, links: Array, diagonal: Array, fixed: Mask
) -> Callable[[Array], Array] | None:
    """P⁻¹ by one V-cycle on the network; None where other rows matter too much.

    Args:
        laplace: L, for its grid.
        links: Conductances to the next voxel in r, θ and z, shape (3, V).
        diagonal: Diagonal of Σ MᵀC M over all rows, shape (V,).
        fixed: Voxels whose values are given, shape (V,).
    """
    grid, free = laplace.operator_grid, laplace.free & ~fixed
    around = np.zeros(grid.n_voxels)
    for axis, link in enumerate(links):
        before = np.roll(grid.unflatten(link), 1, axis).reshape(-1)
        around += link + before
    if not around[free].sum() > DIFFERENCES * diagonal[free].sum():
        return None
    rest, strength = np.maximum(diagonal - around, 0.0), float(around[free].mean())
    own = conductances(grid)
    more = (
        grid.unflatten(link / strength) - along[:, None, None]
        for link, along in zip(links, own, strict=True)
    )
    added = Added(grid.unflatten(rest / strength), tuple(more))
    cycle = OneCycle(grid, grid.unflatten(free), added=added)
    others = np.flatnonzero(~free)
    alone = np.where(diagonal > 0.0, diagonal, 1.0)[others]

    def apply(v: Array) -> Array:
        out = cycle.solve(v).x
        out /= strength
        out[others] = v[others] / alone
        return out

    return apply
