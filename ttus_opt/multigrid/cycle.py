"""One V-cycle of the multigrid solver, and what it keeps.

A `Hierarchy` is what a mask on a grid amounts to and never changes; a `Workspace`
is what one solve writes to. Solves with a workspace each may run side by side; all
coarser levels are one call of compiled code, so that small pieces of work do not wait
for the interpreter's lock.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ttus_opt.compiled import compiled
from ttus_opt.multigrid import kernels, line_smoother, transfer
from ttus_opt.multigrid.coarsening import (
    DIRECT_NODES,
    Box,
    Layout,
    Network,
    coarsen,
    conductances,
    finest,
    plan,
)
from ttus_opt.multigrid.kernels import Numbers, Single

#: Arrays of all levels but the finest, one after the other, and a row of whole numbers
#: for each: where it begins, n_r, width, the coarsened directions and `Numbers`. (A
#: tuple of arrays per level would do, but takes twice as long to compile.)
Coarser = tuple[Single, NDArray[np.int64]]

#: Right-hand side, correction and residual of a level
Work = tuple[Single, Single, Single]

#: Halves of a coarser level (R, T, Z, inverse pivots, six weights) and of its work
LEVEL_HALVES, WORK_HALVES = 20, 5

#: Levels begin at a multiple of so many numbers, their work at one of 16: a cache line
ALIGNED = 16 * LEVEL_HALVES // WORK_HALVES


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
        inverse = line_smoother.pivots(layout.split(network.aside), R)
        return cls(layout, R, T, Z, inverse, (half,) * 6, flags)

    def tied(self, network: Network) -> Level:
        """The grid itself with ties, of which links along spokes alone know."""
        R = self.layout.split(network.links[0])
        inverse = line_smoother.pivots(self.layout.split(network.aside), R)
        along = (self.layout.split(w) for w in network.weights(0))
        weights = (*along, *self.weights[2:])
        return replace(self, R=R, inverse=inverse, weights=weights)

    @classmethod
    def coarse(cls, network: Network, flags: tuple[bool, bool, bool]) -> Level:
        """A coarser level."""
        layout = Layout.of(network.shape)
        R, T, Z = (layout.split(v) for v in network.links)
        inverse = line_smoother.pivots(layout.split(network.aside), R)
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
            line_smoother.sweep_alone(x, b, *pivots, colour, self.layout.numbers)
            return
        rest = (*pivots, self.T, self.Z, colour, self.layout.numbers)
        if b is None:
            line_smoother.sweep_unloaded(x, opposite, *rest)
        else:
            line_smoother.sweep(x, opposite, b, *rest)

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
        coarser: All levels but the finest, for compiled code; they share its memory.
    """

    levels: tuple[Level, ...]
    places: NDArray[np.int64] = field(repr=False)
    inverse: Single = field(repr=False)
    coarser: Coarser = field(repr=False)

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
        below, coarser = _packed(levels[1:])
        return cls((levels[0], *below), places, inverse, coarser)

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
        self.b = [np.zeros(shapes[0], np.float32)]
        self.x = [np.zeros(shapes[0], np.float32)]
        self.residual = [np.zeros(shapes[0][1:], np.float32)]
        values, sizes = hierarchy.coarser
        self.coarser = np.zeros(values.size * WORK_HALVES // LEVEL_HALVES, np.float32)
        for n in range(len(sizes)):
            b, x, residual = work_of(self.coarser, sizes, n)
            self.b.append(b)
            self.x.append(x)
            self.residual.append(residual)

    @property
    def memory_bytes(self) -> int:
        """Size of the arrays."""
        return sum(a.nbytes for a in (*self.b, *self.x, *self.residual))


def _packed(levels: list[Level]) -> tuple[list[Level], Coarser]:
    """Levels below the finest in one array, and that array."""
    sizes = np.zeros((len(levels), 9), np.int64)
    end = 0
    for n, level in enumerate(levels):
        _, n_r, width = level.shape
        sizes[n] = (end, n_r, width, *level.flags, *level.layout.numbers)
        end += -(-LEVEL_HALVES * n_r * width // ALIGNED) * ALIGNED
    values = np.zeros(end, np.float32)
    packed = []
    for n, level in enumerate(levels):
        R, T, Z, inverse, weights, _, _ = level_of(values, sizes, n)
        R[:], T[:], Z[:], inverse[:] = level.R, level.T, level.Z, level.inverse
        for own, weight in zip(weights, level.weights, strict=True):
            own[:] = weight
        packed.append(replace(level, R=R, T=T, Z=Z, inverse=inverse, weights=weights))
    return packed, (values, sizes)


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
    transfers = (
        level.weights,
        level.flags,
        numbers,
        hierarchy.levels[1].layout.numbers,
    )
    level.sweep(1, x, None, b[1])
    level.sweep(0, x, x[1], b[0])
    level.couple(residual, x[0])
    if sweeps == 2:
        level.sweep(1, x, x[0], b[1])
        level.sweep(0, x, x[1], b[0])
        level.couple(residual, x[0], since=True)
    transfer.restrict(work.b[1], residual, *transfers)
    cycle_below(*hierarchy.coarser, work.coarser, *bottom)
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
def level_of(
    values: Single, sizes: NDArray[np.int64], n: int
) -> tuple[
    Single, Single, Single, Single, tuple[Single, ...], tuple[bool, ...], Numbers
]:
    """A level of `Coarser`: as `Level`, with its numbers (compiled)."""
    start, n_r, width = sizes[n, 0], sizes[n, 1], sizes[n, 2]
    end = start + LEVEL_HALVES * n_r * width
    a = values[start:end].reshape((LEVEL_HALVES // 2, 2, n_r, width))
    flags = (sizes[n, 3] != 0, sizes[n, 4] != 0, sizes[n, 5] != 0)
    numbers = (sizes[n, 6], sizes[n, 7], sizes[n, 8])
    weights = (a[4], a[5], a[6], a[7], a[8], a[9])
    return a[0], a[1], a[2], a[3], weights, flags, numbers


@compiled(nogil=True)
def work_of(work: Single, sizes: NDArray[np.int64], n: int) -> Work:
    """Right-hand side, correction and residual of a level of `Coarser` (compiled)."""
    n_r, width = sizes[n, 1], sizes[n, 2]
    start = sizes[n, 0] * WORK_HALVES // LEVEL_HALVES
    both, end = 2 * n_r * width, start + WORK_HALVES * n_r * width
    return (
        work[start : start + both].reshape((2, n_r, width)),
        work[start + both : start + 2 * both].reshape((2, n_r, width)),
        work[start + 2 * both : end].reshape((n_r, width)),
    )


@compiled(nogil=True)
def cycle_below(
    values: Single,
    sizes: NDArray[np.int64],
    work: Single,
    places: NDArray[np.int64],
    bottom: Single,
) -> None:
    """The V-cycle on all levels but the finest, from its right-hand side (compiled).

    Args:
        values: Of `Hierarchy.coarser`.
        sizes: Of `Hierarchy.coarser`.
        work: `Workspace.coarser`.
        places: Of the coarsest level's unknowns.
        bottom: Inverse of its matrix.
    """
    last = len(sizes) - 1
    for n in range(last):
        R, T, Z, inverse, weights, flags, numbers = level_of(values, sizes, n)
        b, x, residual = work_of(work, sizes, n)
        x[:] = 0
        for half in range(2):
            for c in range(1, -1, -1):
                line_smoother.sweep(x, x[1 - c], b[c], inverse[c], R, T, Z, c, numbers)
            less = np.float32(half)
            kernels.couple(residual, x[0], less, inverse[1], T, Z, numbers)
        below, _, _ = work_of(work, sizes, n + 1)
        coarse = (sizes[n + 1, 6], sizes[n + 1, 7], sizes[n + 1, 8])
        transfer.restrict(below, residual, weights, flags, numbers, coarse)
    b, x, _ = work_of(work, sizes, last)
    numbers = (sizes[last, 6], sizes[last, 7], sizes[last, 8])
    direct(x, b[0], b[1], places, bottom, numbers)
    for n in range(last - 1, -1, -1):
        R, T, Z, inverse, weights, flags, numbers = level_of(values, sizes, n)
        b, x, _ = work_of(work, sizes, n)
        _, below, _ = work_of(work, sizes, n + 1)
        coarse = (sizes[n + 1, 6], sizes[n + 1, 7], sizes[n + 1, 8])
        transfer.prolong(x[1], below, weights, flags, numbers, coarse)
        kernels.close_circle(x, 1, numbers)
        for half in range(4):
            c = half % 2
            line_smoother.sweep(x, x[1 - c], b[c], inverse[c], R, T, Z, c, numbers)
