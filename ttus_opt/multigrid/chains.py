"""Chains of voxels along spokes that move as one.

With P giving every voxel of a chain its chain's one value, vectors of unknowns z are
kept where the chains' leaders are, zero at the others: `spread` makes P z of them,
`gather` makes Pᵀ b.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ttus_opt.arrays import Array, IntArray, Mask
from ttus_opt.compiled import compiled
from ttus_opt.multigrid.coarsening import Layout

#: Places of followers and of their leaders in one half
Places = tuple[IntArray, IntArray]


def chain_heads(ties: Mask, stride: int) -> IntArray:
    """The innermost voxel of every voxel's chain; a voxel alone is its own.

    Args:
        ties: Voxels tied to the next one outwards, shape (V,).
        stride: Flat distance to the next voxel outwards [–].

    Returns:
        Flat indices, shape (V,).
    """
    head = np.arange(len(ties))
    for start in range(stride, len(ties), stride):  # layer by layer, outwards
        own, inner = slice(start, start + stride), slice(start - stride, start)
        head[own] = np.where(ties[inner], head[inner], head[own])
    return head


@dataclass(frozen=True)
class Chains:
    """Who follows whom.

    Attributes:
        followers: Voxels, shape (k,).
        leaders: The voxel at which the chain of each stands, shape (k,).
    """

    followers: IntArray = field(repr=False)
    leaders: IntArray = field(repr=False)

    @classmethod
    def of(cls, free: Mask, ties: Mask, leads: Mask, stride: int) -> Chains:
        """Read chains off their ties.

        Args:
            free: Unknown voxels, shape (V,); a chain is free as a whole.
            ties: Voxels tied to the next one outwards, shape (V,).
            leads: Free voxels outside chains, and one of each chain, shape (V,).
            stride: From a voxel to the next one outwards.
        """
        head = chain_heads(ties, stride)
        leader = np.arange(len(free))
        leader[head[leads]] = np.flatnonzero(leads)
        followers = np.flatnonzero(free & ~leads)
        return cls(followers, leader[head[followers]])

    @property
    def longest(self) -> int:
        """Voxels of the longest chain [–]."""
        if not len(self.leaders):
            return 1
        return 1 + int(np.unique(self.leaders, return_counts=True)[1].max())

    def spread(self, z: Array) -> None:
        """Turn unknowns into values, shape (V,), in place."""
        z[self.followers] = z[self.leaders]

    def gather(self, b: Array) -> None:
        """Turn loads into those of unknowns, shape (V,), in place."""
        np.add.at(b, self.leaders, b[self.followers])
        b[self.followers] = 0.0

    def places(self, layout: Layout) -> tuple[Places, Places]:
        """Where they lie in either half, flat; a chain is of one colour.

        Args:
            layout: Of the grid.
        """
        half = layout.shape[0] * layout.width
        followers, leaders = (
            layout.places(np.unravel_index(v, layout.shape))
            for v in (self.followers, self.leaders)
        )
        zero = followers < half
        one = ~zero
        return (followers[zero], leaders[zero]), (
            followers[one] - half,
            leaders[one] - half,
        )


@compiled(inner=True, nogil=True)
def gather_half(b: NDArray[np.float32], places: Places) -> None:
    """`Chains.gather` in one half, shape (n_r, width) (compiled)."""
    followers, leaders = places
    flat = b.reshape(-1)
    for n in range(followers.size):
        flat[leaders[n]] += flat[followers[n]]
        flat[followers[n]] = 0
