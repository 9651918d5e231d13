"""Coarsening of a grid with Dirichlet nodes in it, as a network of conductances.

Every level is a box of nodes (i, j, k) with a conductance on each link to the next
node in r, θ and z, and per direction a conductance to the Dirichlet nodes around.
Coarsening drops every second node along an axis and eliminates it from its own line
(the one-dimensional Schur complement), as in black-box multigrid (J. E. Dendy, J.
Comput. Phys. 48, 1982, 366-386), so that

- a surface that lies between two coarse nodes cuts their link and grounds both
  sides at the true distance: closed surfaces stay closed on every level, and the
  boundary keeps its place to second order, as with ghost values (F. Gibou and others,
  J. Comput. Phys. 176, 2002, 205-227);
- grids of any size coarsen (the last cell may be narrower than the others);
- interpolation along a line is the same elimination read backwards.

Semicoarsening: of θ and z, only the one with the smaller step is coarsened until both
steps are about equal, because an error that oscillates along the wider one would
neither be smoothed nor seen on the coarse level. Lines along r are solved exactly, so r
is left out only while its own step is the wide one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.laplace.multigrid.red_black import Single
from ttus_opt.laplace.multigrid.subdomain import Box, Subdomain

#: A level with at most this many free nodes is solved directly.
DIRECT_NODES = 100
#: A direction is coarsened while its step is at most so many times that of θ and z.
STEP_RATIO = 1.6
#: Factor on the conductance of a link within a pooled block: its ends are then equal
#: in single precision [–]
STIFFNESS = 1e7

R, THETA, Z = 0, 1, 2


@dataclass(frozen=True)
class Grounds:
    """Corrections to the conductance of links that the boundary cuts.

    A boundary between two nodes shortens their link, which then conducts more
    (`ttus_opt.voxmap.cut_links`). Links to other fixed neighbours are not corrected.

    Attributes:
        voxels: Flat indices of the free ends, ascending and unique, shape (k,).
        changes: What is added along r, θ and z, shape (k, 3) [m].
    """

    voxels: IntArray = field(repr=False)
    changes: Array = field(repr=False)

    def within(self, part: Subdomain) -> Grounds:
        """The same on a part of the grid."""
        nodes = np.stack(part.nodes(self.voxels))
        there = ((nodes >= 0) & (nodes < np.array(part.shape)[:, None])).all(axis=0)
        voxels = np.ravel_multi_index(tuple(nodes[:, there]), part.shape)
        order = np.argsort(voxels)
        return Grounds(voxels[order], self.changes[there][order])

    def where(self, free: NDArray[np.bool_]) -> Grounds:
        """The corrections at free voxels; ``free`` has shape (V,)."""
        kept = free[self.voxels]
        return Grounds(self.voxels[kept], self.changes[kept])


@dataclass(frozen=True)
class Added:
    """Additions to the operator of a grid, on arrays of its shape.

    Attributes:
        screening: Added to the diagonal of free nodes, not negative [m]; or None.
        links: Per direction, added to the conductance to the next node, which must stay
            non-negative [m]; may be empty.
        grounds: Added to the conductance to fixed nodes; or None.
    """

    screening: Array | None = field(default=None, repr=False)
    links: tuple[Array, ...] = field(default=(), repr=False)
    grounds: Grounds | None = field(default=None, repr=False)

    def within(self, part: Subdomain) -> Added:
        """The same on a part of the grid."""
        links: tuple[Array, ...] = tuple(part.restrict(v) for v in self.links)
        screening, grounds = self.screening, self.grounds
        return Added(
            None if screening is None else part.restrict(screening),
            links,
            None if grounds is None else grounds.within(part),
        )


@dataclass(frozen=True)
class Network:
    """Conductances of a level; zero wherever a node is fixed.

    Attributes:
        free: Nodes that are unknown, shape (n_r, n_theta, n_z).
        links: Per direction the conductance to the next node, same shape [m].
        grounds: Per direction the conductance to fixed neighbours, same shape [m].
        positions: Per direction the nodes' places, in steps of the finest grid [–].
        turn: Length of a full turn in θ, in steps of the finest grid [–].
        screening: Addition to the diagonal, integrated over a node's cell, same
            shape; None for nothing [m].
    """

    free: NDArray[np.bool_]
    links: tuple[Single, ...]
    grounds: tuple[Single, ...]
    positions: tuple[Array, ...]
    turn: int
    screening: Single | None = None

    @property
    def shape(self) -> tuple[int, int, int]:
        """Nodes (n_r, n_theta, n_z) [–]."""
        return self.free.shape

    @property
    def n_free(self) -> int:
        """Number of unknowns [–]."""
        return int(np.count_nonzero(self.free))

    @property
    def aside(self) -> Single:
        """The diagonal of the operator without links along r, same shape [m]."""
        total = np.zeros(self.free.shape, dtype=np.float32)
        for axis in (THETA, Z):
            total += self.links[axis]
            total += np.roll(self.links[axis], 1, axis)
        for ground in self.grounds:
            total += ground
        if self.screening is not None:
            total += self.screening
        return total

    def plus(self, added: Added) -> Network:
        """The same with more conductances and screening."""
        links, grounds = list(self.links), list(self.grounds)
        for axis, wide in enumerate(added.links):
            link, ground = _conducting(self.free, axis, wide.astype(np.float32))
            links[axis], grounds[axis] = links[axis] + link, grounds[axis] + ground
        if added.grounds is not None:
            own = added.grounds.where(self.free.reshape(-1))
            nodes = np.unravel_index(own.voxels, self.shape)
            for axis in (R, THETA, Z):
                grounds[axis] = grounds[axis].copy()
                grounds[axis][nodes] += own.changes[:, axis].astype(np.float32)
        screening = self.screening
        if added.screening is not None:
            screening = np.where(self.free, added.screening, 0.0).astype(np.float32)
        return replace(
            self, links=tuple(links), grounds=tuple(grounds), screening=screening
        )

    def with_blocks(self, pooled: NDArray[np.bool_]) -> Network:
        """The same with nodes that are pooled with the next layer's, same shape."""
        along, *across = self.links
        strong = np.where(pooled, along * np.float32(STIFFNESS), along)
        return replace(self, links=(strong, *across))

    def weights(self, axis: int) -> tuple[Single, Single]:
        """Weights of the node before and the node after, if a node is dropped."""
        after = self.links[axis]
        before = np.roll(after, 1, axis)
        total = after + before + self.grounds[axis]
        total[total == 0] = 1.0
        return before / total, after / total

    def matrix(self) -> Array:
        """The operator on the free nodes, dense (n_free, n_free) [m]."""
        nodes = np.nonzero(self.free)
        number = np.full(self.shape, -1)
        number[nodes] = np.arange(self.n_free)
        # in double precision, where strong links leave the others their digits
        diagonal = self.aside.astype(float)
        diagonal += self.links[R].astype(float) + np.roll(self.links[R], 1, R)
        A = np.diag(diagonal[nodes])
        for axis in (R, THETA, Z):
            link = self.links[axis][nodes]
            here = np.flatnonzero(link)
            there = np.roll(number, -1, axis)[nodes][here]
            np.subtract.at(A, (here, there), link[here])
            np.subtract.at(A, (there, here), link[here])
        return A

    def cells(self, axis: int) -> Array:
        """Width of every node's cell along one direction [–]."""
        places = self.positions[axis]
        if axis == THETA:
            ends = (places[-1] - self.turn, places[0] + self.turn)
        else:
            ends = (2 * places[0] - places[1], 2 * places[-1] - places[-2])
        around = np.concatenate([[ends[0]], places, [ends[1]]])
        width: Array = (around[2:] - around[:-2]) / 2.0
        return width


def conductances(grid: Box) -> tuple[Array, Array, Array]:
    """Conductances of the grid: A is r times the stencil of the free voxels.

    Args:
        grid: The grid.

    Returns:
        To the next layer, spoke and slice, shape (n_r,) each [m].
    """
    return (
        grid.r + grid.r_step / 2.0,
        grid.r_step**2 / (grid.r * grid.theta_step**2),
        grid.r * (grid.r_step / grid.z_step) ** 2,
    )


def finest(grid: Box, free: NDArray[np.bool_]) -> Network:
    """The network of the grid itself.

    Args:
        grid: The grid.
        free: Unknown voxels, shape ``grid.shape``.

    Returns:
        Its network; links between two free voxels are never cut.
    """
    links, grounds = zip(
        *(
            _conducting(free, axis, value.astype(np.float32)[:, None, None])
            for axis, value in enumerate(conductances(grid))
        ),
        strict=True,
    )
    positions = tuple(np.arange(n, dtype=float) for n in free.shape)
    return Network(free, links, grounds, positions, free.shape[THETA])


def _conducting(
    free: NDArray[np.bool_], axis: int, after: Single
) -> tuple[Single, Single]:
    """Conductances to the next free node and to fixed ones, by those of all links."""
    joined = free & np.roll(free, -1, axis)
    ground = (free & ~joined) * after
    ground += (free & ~np.roll(joined, 1, axis)) * np.roll(after, 1, axis)
    return joined * after, ground


def coarsen(network: Network, axis: int) -> Network:
    """Drop every second node along one axis, eliminated from its own line.

    Args:
        network: The finer network.
        axis: `R`, `THETA` or `Z`.

    Returns:
        The network of nodes 0, 2, 4, … and, unless the axis is θ, the last one.
    """
    n = network.free.shape[axis]
    periodic = axis == THETA
    kept = np.arange(0, n, 2)
    if not periodic and n % 2 == 0:
        kept = np.append(kept, n - 1)
    # nodes 1, 3, 5, … with a kept node on both sides
    mid = np.arange(1, n if periodic and n % 2 == 0 else n - 1, 2)
    left, right = mid // 2, (mid // 2 + 1) % len(kept)

    link = np.moveaxis(network.links[axis], axis, 0)
    ground = np.moveaxis(network.grounds[axis], axis, 0)
    new_link, new_ground = link[kept], ground[kept]
    a, b, g = link[mid - 1], link[mid], ground[mid]
    total = a + b + g
    total[total == 0] = 1.0
    new_link[left] = a * b / total
    new_ground[left] += a * g / total
    new_ground[right] += b * g / total

    positions = list(network.positions)
    positions[axis] = positions[axis][kept]
    coarse = replace(network, positions=tuple(positions))
    growth = (coarse.cells(axis) / network.cells(axis)[kept]).astype(np.float32)
    growth = np.expand_dims(growth, tuple(a for a in (R, THETA, Z) if a != axis))
    links = [np.take(v, kept, axis) * growth for v in network.links]
    grounds = [np.take(v, kept, axis) * growth for v in network.grounds]
    links[axis] = np.ascontiguousarray(np.moveaxis(new_link, 0, axis))
    grounds[axis] = np.ascontiguousarray(np.moveaxis(new_ground, 0, axis))
    free = np.take(network.free, kept, axis)
    screening = network.screening
    if screening is not None:  # half of a dropped node's goes to either neighbour
        fine = np.moveaxis(screening, axis, 0)
        new = fine[kept]
        new[left] += 0.5 * fine[mid]
        new[right] += 0.5 * fine[mid]
        screening = np.moveaxis(new, 0, axis) * free
    return replace(
        coarse,
        free=free,
        links=tuple(links),
        grounds=tuple(grounds),
        screening=screening,
    )


def plan(grid: Box) -> Iterator[tuple[bool, bool, bool]]:
    """The directions to coarsen, step by step, until none can be coarsened.

    Args:
        grid: The finest grid.

    Yields:
        Whether to coarsen r, θ and z.
    """
    counts = list(grid.shape)
    # θ counts at the geometric mean radius: its step varies with r, the others' not
    radius = float(np.sqrt(grid.r[0] * grid.r[-1]))
    steps = np.array([grid.r_step, radius * grid.theta_step, grid.z_step])
    while True:
        able = np.array([counts[R] > 3, counts[THETA] > 5, counts[Z] > 3])
        if not able.any():
            return
        across = np.where(able, steps, np.inf)[THETA:].min()
        limit = STEP_RATIO * (across if np.isfinite(across) else steps[R])
        chosen = able & (steps <= limit)
        yield bool(chosen[R]), bool(chosen[THETA]), bool(chosen[Z])
        for axis in np.flatnonzero(chosen):
            n = counts[axis]
            counts[axis] = (n + 1) // 2 if axis == THETA else n // 2 + 1
            steps[axis] *= 2.0
