"""One V-cycle of the multigrid solver, and what it keeps.

A `Hierarchy` is what a mask on a grid amounts to and never changes; a `Workspace`
is what one solve writes to. Solves with a workspace each may run side by side.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ttus_opt.multigrid import kernels, lines, transfer
from ttus_opt.multigrid.kernels import Single
from ttus_opt.multigrid.levels import (
    DIRECT_NODES,
    Box,
    Layout,
    Network,
    coarsen,
    conductances,
    finest,
    plan,
)


@dataclass(frozen=True)
class Level:
    """Operator of one level and transfers to the next one.

    Attributes:
        layout: Where nodes are stored.
        R: Conductances to the next layer; on the finest level one number per layer,
            shape (n_r,), elsewhere in halves, shape (2, n_r, width) [m].
        T: Conductances to the next spoke, same [m].
        Z: Conductances to the next slice, same [m].
        inverse: Inverse pivots of the radial lines, in halves [1/m].
        weights: See `transfer`.
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
        cls, grid: Box, network: Network, flags: tuple[bool, bool, bool]
    ) -> Level:
        """The grid itself: conductances depend on the layer alone."""
        layout = Layout.of(grid.shape)
        R, T, Z = (v.astype(np.float32) for v in conductances(grid))
        # a dropped node has equal neighbours, and none if it is fixed
        half = layout.split(network.free * np.float32(0.5))
        inverse = lines.pivots(layout.split(network.diagonal), R)
        return cls(layout, R, T, Z, inverse, (half,) * 6, flags)

    @classmethod
    def coarse(cls, network: Network, flags: tuple[bool, bool, bool]) -> Level:
        """A coarser level."""
        layout = Layout.of(network.shape)
        R, T, Z = (layout.split(v) for v in network.links)
        inverse = lines.pivots(layout.split(network.diagonal), R)
        weights = tuple(
            layout.split(w) for axis in range(3) for w in network.weights(axis)
        )
        return cls(layout, R, T, Z, inverse, weights, flags)

    @property
    def is_odd(self) -> bool:
        """Whether the number of spokes is odd: both colours meet where θ closes."""
        return self.layout.shape[1] % 2 == 1

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of values in halves."""
        return self.inverse.shape

    @property
    def memory_bytes(self) -> int:
        """Size of its arrays."""
        weights = {id(w): w.nbytes for w in self.weights}
        arrays = (self.R, self.T, self.Z, self.inverse)
        return sum(a.nbytes for a in arrays) + sum(weights.values())

    def sweep(
        self, colour: int, x: Single, opposite: Single | None, b: Single | None
    ) -> None:
        """Solve all lines of one colour, in place.

        Args:
            colour: 0 or 1.
            x: Both halves; that of this colour is overwritten, (2, n_r, width).
            opposite: Values of the other colour, None for zero, (n_r, width).
            b: Right-hand side of this colour, None for zero, (n_r, width).
        """
        pivots = (self.inverse[colour], self.R)
        if opposite is None:
            lines.sweep_alone(x, b, *pivots, colour, self.layout.numbers)
            return
        rest = (*pivots, self.T, self.Z, colour, self.layout.numbers)
        if b is None:
            lines.sweep_unloaded(x, opposite, *rest)
        else:
            lines.sweep(x, opposite, b, *rest)

    def couple(self, out: Single, opposite: Single, *, since: bool = False) -> None:
        """What flows into colour 1 from colour 0.

        Right after colour 1 was solved from zero and colour 0 after it, this is the
        residual of colour 1; after a second sweep it is what this has grown by.

        Args:
            out: Result, (n_r, width).
            opposite: Values of colour 0, (n_r, width).
            since: Take off what ``out`` holds.
        """
        kernels.couple(
            out,
            opposite,
            np.float32(since),
            self.inverse[1],
            self.T,
            self.Z,
            self.layout.numbers,
        )


@dataclass(frozen=True)
class Hierarchy:
    """All levels, and the direct solution of the coarsest.

    Attributes:
        levels: From fine to coarse.
        places: Flat places of the coarsest level's free nodes in halves.
        inverse: Inverse of the coarsest level's matrix [1/m].
    """

    levels: tuple[Level, ...]
    places: NDArray[np.int64] = field(repr=False)
    inverse: Single = field(repr=False)

    @classmethod
    def build(
        cls,
        grid: Box,
        free: NDArray[np.bool_],
        stiffness: Single | None = None,
    ) -> Hierarchy:
        """Coarsen until the rest is small.

        Args:
            grid: The grid.
            free: Unknown voxels, shape ``grid.shape``.
            stiffness: Factor of every conductance to the next layer, same shape;
                None for 1.
        """
        network = finest(grid, free)
        if stiffness is not None:
            network = network.stiffened(stiffness)
        levels: list[Level] = []
        for flags in (*plan(grid), (False, False, False)):
            if network.n_free <= DIRECT_NODES:
                flags = (False, False, False)
            levels.append(
                Level.coarse(network, flags)
                if levels or stiffness is not None
                else Level.finest(grid, network, flags)
            )
            if not any(flags):
                break
            for axis in np.flatnonzero(flags):
                network = coarsen(network, int(axis))
        inverse = np.linalg.inv(network.matrix()).astype(np.float32)
        places = levels[-1].layout.places(np.nonzero(network.free))
        return cls(tuple(levels), places, inverse)

    @property
    def memory_bytes(self) -> int:
        """Size of its arrays."""
        return sum(v.memory_bytes for v in self.levels) + self.inverse.nbytes


class Workspace:
    """Arrays that one solve writes to.

    Attributes:
        b: Per level the right-hand side, in halves.
        x: Per level the correction, in halves.
        residual: Per level the residual of colour 1.
    """

    def __init__(self, hierarchy: Hierarchy) -> None:
        shapes = [level.shape for level in hierarchy.levels]
        self.b = [np.zeros(shape, np.float32) for shape in shapes]
        self.x = [np.zeros(shape, np.float32) for shape in shapes]
        self.residual = [np.zeros(shape[1:], np.float32) for shape in shapes]

    @property
    def memory_bytes(self) -> int:
        """Size of its arrays."""
        return sum(a.nbytes for a in (*self.b, *self.x, *self.residual))


def cycle(
    hierarchy: Hierarchy,
    work: Workspace,
    b: tuple[Single | None, Single],
    number: int = 0,
    *,
    sweeps: int = 1,
) -> None:
    """One symmetric V-cycle from zero; the answer is ``work.x[number]``.

    Two sweeps before and after on all levels but the finest, where they cost little
    and keep the number of cycles from growing with the grid.

    Args:
        hierarchy: The levels.
        work: Where it works.
        b: Right-hand side of both colours, each (n_r, width); that of colour 0 may
            be None for zero on the finest level, if there is more than one level.
        number: Level to start from.
        sweeps: On the finest level before and after, 1 or 2 [–].
    """
    level, x = hierarchy.levels[number], work.x[number]
    if number == len(hierarchy.levels) - 1:
        kernels.direct(x, b[0], b[1], hierarchy.places, hierarchy.inverse)
        kernels.close_circle(x, 0, level.layout.numbers)
        kernels.close_circle(x, 1, level.layout.numbers)
        return
    if level.is_odd:
        x.fill(0)  # where θ closes a sweep reads the old values of its own colour
    residual, twice = work.residual[number], number > 0 or sweeps == 2
    coarse = hierarchy.levels[number + 1].layout.numbers
    transfers = (level.weights, level.flags, level.layout.numbers, coarse)
    level.sweep(1, x, None, b[1])
    level.sweep(0, x, x[1], b[0])
    level.couple(residual, x[0])
    if twice:
        level.sweep(1, x, x[0], b[1])
        level.sweep(0, x, x[1], b[0])
        level.couple(residual, x[0], since=True)
    below = work.b[number + 1]
    transfer.restrict(below, residual, *transfers)
    cycle(hierarchy, work, (below[0], below[1]), number + 1)
    transfer.prolong(x[1], work.x[number + 1], *transfers)
    kernels.close_circle(x, 1, level.layout.numbers)
    for _ in range(2 if twice else 1):
        level.sweep(0, x, x[1], b[0])
        level.sweep(1, x, x[0], b[1])
