"""The levels of a mask on a grid, which never change.

What a solve writes to is its own (`workspace`): several may run side by side.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ttus_opt.laplace.multigrid.coarsening import (
    DIRECT_NODES,
    Added,
    Grounds,
    Network,
    coarsen,
    conductances,
    finest,
    plan,
)
from ttus_opt.laplace.multigrid.kernels import LevelIndex, Table
from ttus_opt.laplace.multigrid.line_smoother import TILE, inverse_pivots
from ttus_opt.laplace.multigrid.red_black import LANES, Layout, Single
from ttus_opt.laplace.multigrid.subdomain import Box
from ttus_opt.laplace.multigrid.transfer import scratch_size


@dataclass(frozen=True)
class Level:
    """Operator of one level and transfers to the next one.

    Attributes:
        layout: Where nodes are stored.
        R: Conductances to the next layer; on the finest level one number per layer,
            shape (n_r,), elsewhere and with pooled blocks in red-black order [m].
        T: Conductances to the next spoke, likewise but for blocks [m].
        Z: Conductances to the next slice, likewise [m].
        inverse: Inverse pivots of the radial lines, in red-black order [1/m].
        weights: Interpolation weights of the node before and after in r, θ, z, each in
            red-black order [–].
        flags: Which of r, θ, z the next level coarsens.
    """

    layout: Layout
    R: Single = field(repr=False)
    T: Single = field(repr=False)
    Z: Single = field(repr=False)
    inverse: Single = field(repr=False)
    weights: tuple[Single, ...] = field(repr=False)
    flags: tuple[bool, bool, bool]

    @classmethod
    def finest(
        cls,
        grid: Box,
        network: Network,
        flags: tuple[bool, bool, bool],
        has_blocks: bool,
    ) -> Level:
        """The grid itself: without blocks, conductances depend on the layer alone."""
        layout = Layout.of(grid.shape)
        R, T, Z = (v.astype(np.float32) for v in conductances(grid))
        # a dropped node has equal neighbours, and none if it is fixed
        half = layout.split(network.free * np.float32(0.5))
        weights: tuple[Single, ...] = (half,) * 6
        if has_blocks:  # which lie along r
            R = layout.split(network.links[0])
            along = (layout.split(w) for w in network.weights(0))
            weights = (*along, *weights[2:])
        inverse = inverse_pivots(layout.split(network.aside), R)
        return cls(layout, R, T, Z, inverse, weights, flags)

    @classmethod
    def coarse(cls, network: Network, flags: tuple[bool, bool, bool]) -> Level:
        """A coarser level."""
        layout = Layout.of(network.shape)
        R, T, Z = (layout.split(v) for v in network.links)
        inverse = inverse_pivots(layout.split(network.aside), R)
        weights = tuple(
            layout.split(w) for axis in range(3) for w in network.weights(axis)
        )
        return cls(layout, R, T, Z, inverse, weights, flags)

    @property
    def is_odd(self) -> bool:
        """Whether the number of spokes is odd: a colour meets itself at θ = 0."""
        return self.layout.shape[1] % 2 == 1

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of values in red-black order."""
        return self.layout.stored_shape

    @property
    def arrays(self) -> tuple[Single, ...]:
        """Coefficients in the order of a `LevelIndex`."""
        return (self.R, self.T, self.Z, self.inverse, *self.weights)


@dataclass(frozen=True)
class Hierarchy:
    """All levels, and the direct solution of the coarsest.

    Attributes:
        levels: From fine to coarse; their arrays are parts of ``fields``.
        places: Flat places of the coarsest level's free nodes.
        inverse: Inverse of the coarsest level's matrix [1/m].
        table: A `LevelIndex` per level, for compiled code.
        fields: Coefficients of all levels.
        work_size: Length of an array that holds the vectors of all levels.
        scratch: Numbers of it that are scratch space.
        cut: Places of the finest level's nodes with cut links, ascending, shape (k,).
        cut_grounds: What this adds to their diagonal, shape (k,) [m].
        boxes: Levels of the last box (`subdomain`) by its place: the next solve near
            the same contact needs them again.
    """

    levels: tuple[Level, ...]
    places: NDArray[np.int64] = field(repr=False)
    inverse: Single = field(repr=False)
    table: Table = field(repr=False)
    fields: Single = field(repr=False)
    work_size: int
    scratch: int
    cut: NDArray[np.int64] = field(repr=False)
    cut_grounds: Single = field(repr=False)
    boxes: dict[object, Hierarchy] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @classmethod
    def build(
        cls,
        grid: Box,
        free: NDArray[np.bool_],
        pooled: NDArray[np.bool_] | None = None,
        added: Added | None = None,
    ) -> Hierarchy:
        """Coarsen until the rest is small.

        Args:
            grid: The grid.
            free: Unknown voxels, shape ``grid.shape``.
            pooled: Those pooled with the next layer's, same shape; None for none.
            added: What is added to the operator; None for nothing.
        """
        network = finest(grid, free)
        uneven = added is not None and bool(added.links)
        if added is not None:
            network = network.plus(added)
        if pooled is not None:
            network = network.with_blocks(pooled)
        levels: list[Level] = []
        for flags in (*plan(grid), (False, False, False)):
            if network.n_free <= DIRECT_NODES:
                flags = (False, False, False)
            if levels or uneven:
                levels.append(Level.coarse(network, flags))
            else:
                levels.append(Level.finest(grid, network, flags, pooled is not None))
            if not any(flags):
                break
            for axis in np.flatnonzero(flags):
                network = coarsen(network, int(axis))
        inverse = np.linalg.inv(network.matrix()).astype(np.float32)
        places = levels[-1].layout.places(np.nonzero(network.free))
        along = conductances(grid)[0].astype(np.float32)
        own = np.zeros_like(along)
        if added is not None and added.screening is not None:
            own = added.screening[:, 0, 0].astype(np.float32)
        packed = _packed(levels, along, own)  # levels then refer to it
        cuts = _cuts(levels[0].layout, free, None if added is None else added.grounds)
        return cls(tuple(levels), places, inverse, *packed, *cuts)


def _cuts(
    layout: Layout, free: NDArray[np.bool_], grounds: Grounds | None
) -> tuple[NDArray[np.int64], Single]:
    """Places of nodes with cut links, and what these add to the diagonal."""
    if grounds is None:
        return np.zeros(0, np.int64), np.zeros(0, np.float32)
    own = grounds.where(free.reshape(-1))
    places = layout.places(np.unravel_index(own.voxels, free.shape))
    order = np.argsort(places)
    sums = own.changes.sum(axis=1).astype(np.float32)
    return places[order], sums[order]


def _packed(
    levels: list[Level], along: Single, own: Single
) -> tuple[Table, Single, int, int]:
    """Coefficients of all levels in one array, which levels then refer to.

    Args:
        levels: From fine to coarse; their arrays become parts of the one.
        along: Conductances along r on the finest level, blocks or not.
        own: Screening on its diagonal, constant within a layer.

    Returns:
        Where each level's arrays begin, that array, and the sizes of a workspace and of
        its scratch space.
    """
    # an array with several names, as the finest level's weights, is stored once
    arrays = {id(a): a for level in levels for a in level.arrays}
    arrays[id(along)], arrays[id(own)] = along, own
    starts, end = {}, 0
    for key, array in arrays.items():
        starts[key] = end
        end += -(-array.size // LANES) * LANES
    fields = np.zeros(end, np.float32)
    parts = {}
    for key, array in arrays.items():
        part = fields[starts[key] : starts[key] + array.size].reshape(array.shape)
        part[:] = array
        parts[key] = part

    top = levels[0].layout
    zeros = max(TILE, top.width + 2 * top.pitch) + LANES
    scratch = scratch_size(top.width, top.pitch)
    table, end = [], zeros + -(-scratch // LANES) * LANES
    for n, level in enumerate(levels):
        size = level.layout.colour_size
        sizes = (*level.shape[1:], *level.layout.shape[1:], level.layout.pitch)
        kinds = (*level.flags, level.R.ndim > 1, level.T.ndim > 1)
        coefficients = (starts[id(a)] for a in (along, own, *level.arrays))
        vectors = (end, end + 2 * size, end + 4 * size, 0, zeros)
        table.append(LevelIndex._make((*sizes, *kinds, *coefficients, *vectors)))
        end += 5 * size
        R, T, Z, inverse, *weights = (parts[id(a)] for a in level.arrays)
        levels[n] = replace(
            level, R=R, T=T, Z=Z, inverse=inverse, weights=tuple(weights)
        )
    return np.array(table, np.int64), fields, end, scratch
