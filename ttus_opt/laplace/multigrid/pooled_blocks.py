"""Pooled blocks: neighbours along a spoke that share one value.

P gives every voxel of a block the value of its block. The unknowns z are stored at the
leaders of the blocks, with zeros at the other voxels: `PooledBlocks.prolong` computes
P z in place, `PooledBlocks.restrict` Pᵀ b.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.core.compiled import compiled
from ttus_opt.laplace.multigrid.red_black import Layout, Single
from ttus_opt.voxmap.grid import nodes_of


def block_heads(pooled: Mask, stride: int) -> IntArray:
    """The innermost voxel of every voxel's block; a voxel alone is its own.

    Args:
        pooled: Voxels pooled with the next one outwards, shape (V,).
        stride: Flat distance to the next voxel outwards [–].

    Returns:
        Flat indices, shape (V,).
    """
    head = np.arange(len(pooled))
    for start in range(stride, len(pooled), stride):  # layer by layer, outwards
        own, inner = slice(start, start + stride), slice(start - stride, start)
        head[own] = np.where(pooled[inner], head[inner], head[own])
    return head


@dataclass(frozen=True)
class PooledBlocks:
    """Voxels that follow the value of another.

    Attributes:
        pooled: Voxels pooled with the next one outwards, shape (V,).
        followers: Voxels, shape (k,).
        leaders: The leader of each follower's block, shape (k,).
    """

    pooled: Mask = field(repr=False)
    followers: IntArray = field(repr=False)
    leaders: IntArray = field(repr=False)

    @classmethod
    def of(cls, free: Mask, pooled: Mask, leads: Mask, stride: int) -> PooledBlocks:
        """Gather the voxels of every block.

        Args:
            free: Unknown voxels, shape (V,); a block is free as a whole.
            pooled: Voxels pooled with the next one outwards, shape (V,).
            leads: Free voxels outside blocks, and one of each block, shape (V,).
            stride: Flat distance to the next voxel outwards [–].
        """
        head = block_heads(pooled, stride)
        leader = np.arange(len(free))
        leader[head[leads]] = np.flatnonzero(leads)
        followers = np.flatnonzero(free & ~leads)
        return cls(pooled, followers, leader[head[followers]])

    @property
    def longest(self) -> int:
        """Voxels of the longest block [–]."""
        if not len(self.leaders):
            return 1
        return 1 + int(np.unique(self.leaders, return_counts=True)[1].max())

    def prolong(self, z: Array) -> None:
        """Set followers to their leader's value, in place; shape (V,)."""
        z[self.followers] = z[self.leaders]

    def restrict(self, b: Array) -> None:
        """Sum the loads of each block at its leader, in place; shape (V,)."""
        np.add.at(b, self.leaders, b[self.followers])
        b[self.followers] = 0.0

    def places(self, layout: Layout, start: int) -> tuple[IntArray, IntArray]:
        """Places of followers and leaders in red-black order; a block has one colour.

        Args:
            layout: Layout of the grid.
            start: Where the vector begins [–].
        """
        followers, leaders = (
            start + layout.places(nodes_of(v, layout.shape))
            for v in (self.followers, self.leaders)
        )
        return followers, leaders


@compiled(nogil=True)
def pool(work: Single, followers: IntArray, leaders: IntArray) -> None:
    """`PooledBlocks.restrict` at places of ``work`` (compiled)."""
    for n in range(followers.size):
        work[leaders[n]] += work[followers[n]]
        work[followers[n]] = 0
