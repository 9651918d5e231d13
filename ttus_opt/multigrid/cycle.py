"""One V-cycle of the multigrid solver, and what it keeps.

A `Hierarchy` is what a mask on a grid amounts to and never changes; a `Workspace`
is what one solve writes to. Solves with a workspace each may run side by side; all
coarser levels are one call of compiled code, so that small pieces of work do not wait
for the interpreter's lock.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ttus_opt.compiled import compiled
from ttus_opt.multigrid import kernels, lines, transfer
from ttus_opt.multigrid.kernels import Numbers, Single
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

#: Of a coarser level: conductances R, T, Z, inverse pivots, transfer weights,
#: coarsened directions and sizes
Coarser = tuple[
    Single, Single, Single, Single, tuple[Single, ...], tuple[bool, ...], Numbers
]

#: Right-hand side, correction and residual of a level
Work = tuple[Single, Single, Single]

#: Coarser levels are filled up to a multiple of so many: code is compiled for each
#: length of a tuple
PADDED = 8


@dataclass(frozen=True)
class Level:
    """Operator of one level and transfers to the next one.

    Attributes:
        layout: Where nodes are stored.
        R: Conductances to the next layer; on the finest level one number per layer,
            shape (n_r,), elsewhere and with ties in halves, (2, n_r, width) [m].
        T: Conductances to the next spoke, likewise but for ties [m].
        Z: Conductances to the next slice, likewise [m].
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
        inverse = lines.pivots(layout.split(network.aside), R)
        return cls(layout, R, T, Z, inverse, (half,) * 6, flags)

    def tied(self, network: Network) -> Level:
        """The grid itself with ties, of which links along spokes alone know."""
        R = self.layout.split(network.links[0])
        inverse = lines.pivots(self.layout.split(network.aside), R)
        along = (self.layout.split(w) for w in network.weights(0))
        weights = (*along, *self.weights[2:])
        return replace(self, R=R, inverse=inverse, weights=weights)

    @classmethod
    def coarse(cls, network: Network, flags: tuple[bool, bool, bool]) -> Level:
        """A coarser level."""
        layout = Layout.of(network.shape)
        R, T, Z = (layout.split(v) for v in network.links)
        inverse = lines.pivots(layout.split(network.aside), R)
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
        ties: NDArray[np.bool_] | None = None,
    ) -> Hierarchy:
        """Coarsen until the rest is small.

        Args:
            grid: The grid.
            free: Unknown voxels, shape ``grid.shape``.
            ties: Those that move with the next layer, same shape; None for none.
        """
        network = finest(grid, free)
        if ties is not None:
            network = network.tied(ties)
        levels: list[Level] = []
        for flags in (*plan(grid), (False, False, False)):
            if network.n_free <= DIRECT_NODES:
                flags = (False, False, False)
            if levels:
                levels.append(Level.coarse(network, flags))
            else:
                level = Level.finest(grid, network, flags)
                levels.append(level if ties is None else level.tied(network))
            if not any(flags):
                break
            for axis in np.flatnonzero(flags):
                network = coarsen(network, int(axis))
        inverse = np.linalg.inv(network.matrix()).astype(np.float32)
        places = levels[-1].layout.places(np.nonzero(network.free))
        return cls(tuple(levels), places, inverse)

    @functools.cached_property
    def coarser(self) -> tuple[Coarser, ...]:
        """All levels but the finest, for compiled code, filled up with the last."""
        return _filled(
            [
                (v.R, v.T, v.Z, v.inverse, v.weights, v.flags, v.layout.numbers)
                for v in self.levels[1:]
            ]
        )

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

    @functools.cached_property
    def coarser(self) -> tuple[Work, ...]:
        """What belongs to all levels but the finest, filled up as those."""
        every = zip(self.b, self.x, self.residual, strict=True)
        return _filled(list(every)[1:])

    @property
    def memory_bytes(self) -> int:
        """Size of its arrays."""
        return sum(a.nbytes for a in (*self.b, *self.x, *self.residual))


def _filled(levels: list[Any]) -> tuple[Any, ...]:
    return tuple(levels + levels[-1:] * (-len(levels) % PADDED))


def cycle(
    hierarchy: Hierarchy,
    work: Workspace,
    b: tuple[Single | None, Single],
    *,
    sweeps: int = 1,
) -> None:
    """One symmetric V-cycle from zero; the answer is ``work.x[0]``.

    Two sweeps before and after on all levels but the finest, where they cost little
    and keep the number of cycles from growing with the grid.

    Args:
        hierarchy: The levels.
        work: Where it works.
        b: Right-hand side of both colours, each (n_r, width); that of colour 0 may
            be None for zero.
        sweeps: On the finest level before and after, 1 or 2 [–].
    """
    level, x, residual = hierarchy.levels[0], work.x[0], work.residual[0]
    numbers, count = level.layout.numbers, len(hierarchy.levels) - 1
    bottom = (hierarchy.places, hierarchy.inverse)
    if count == 0:
        direct(x, *b, *bottom, numbers)
        return
    if level.is_odd:
        x.fill(0)  # where θ closes a sweep reads the old values of its own colour
    transfers = (level.weights, level.flags, numbers, hierarchy.coarser[0][-1])
    level.sweep(1, x, None, b[1])
    level.sweep(0, x, x[1], b[0])
    level.couple(residual, x[0])
    if sweeps == 2:
        level.sweep(1, x, x[0], b[1])
        level.sweep(0, x, x[1], b[0])
        level.couple(residual, x[0], since=True)
    transfer.restrict(work.b[1], residual, *transfers)
    cycle_below(hierarchy.coarser, work.coarser, count, *bottom)
    transfer.prolong(x[1], work.x[1], *transfers)
    kernels.close_circle(x, 1, numbers)
    for _ in range(sweeps):
        level.sweep(0, x, x[1], b[0])
        level.sweep(1, x, x[0], b[1])


@compiled(nogil=True)
def direct(
    x: Single,
    b0: Single | None,
    b1: Single,
    places: NDArray[np.int64],
    inverse: Single,
    numbers: Numbers,
) -> None:
    """Solve the coarsest level (compiled)."""
    kernels.direct(x, b0, b1, places, inverse)
    for colour in range(2):
        kernels.close_circle(x, colour, numbers)


@compiled(nogil=True)
def _smooth(level: Coarser, b: Single, x: Single, first: int, count: int) -> None:
    """Solve the lines of one colour, then of the other, and so on (compiled)."""
    R, T, Z, inverse, _, _, numbers = level
    for n in range(first, first + count):
        c = n % 2
        lines.sweep(x, x[1 - c], b[c], inverse[c], R, T, Z, c, numbers)


@compiled(nogil=True)
def cycle_below(
    levels: tuple[Coarser, ...],
    work: tuple[Work, ...],
    count: int,
    places: NDArray[np.int64],
    bottom: Single,
) -> None:
    """The V-cycle on all levels but the finest, from its right-hand side (compiled).

    Args:
        levels: `Hierarchy.coarser`.
        work: `Workspace.coarser`.
        count: How many levels there are.
        places: Of the coarsest level's unknowns.
        bottom: Inverse of its matrix.
    """
    for n in range(count - 1):
        _, T, Z, inverse, weights, flags, numbers = levels[n]
        b, x, residual = work[n]
        x[:] = 0
        for half in range(2):
            _smooth(levels[n], b, x, 1, 2)
            less = np.float32(half)
            kernels.couple(residual, x[0], less, inverse[1], T, Z, numbers)
        below = work[n + 1][0]
        transfer.restrict(below, residual, weights, flags, numbers, levels[n + 1][-1])
    b, x, _ = work[count - 1]
    direct(x, b[0], b[1], places, bottom, levels[count - 1][-1])
    for n in range(count - 2, -1, -1):
        _, _, _, _, weights, flags, numbers = levels[n]
        b, x, _ = work[n]
        below = work[n + 1][1]
        transfer.prolong(x[1], below, weights, flags, numbers, levels[n + 1][-1])
        kernels.close_circle(x, 1, numbers)
        _smooth(levels[n], b, x, 0, 4)
