"""Vectors of one solve and the V-cycle on them, on one core or on several.

On a large level each core takes some of the radial lines, or some of the layers, and
waits for the others before the next sweep. What is computed, and in which order sums
are taken, does not depend on the number of cores: equal calls give equal bits. Small
levels are done by one core, in one call of compiled code (`v_cycle`): to wait for each
other, or between two kernels for the interpreter's lock, would take longer than the
work.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.compiled import compiled
from ttus_opt.core.threads import in_parts, parts_of
from ttus_opt.laplace.multigrid.hierarchy import Hierarchy
from ttus_opt.laplace.multigrid.kernels import (
    FAST,
    LevelIndex,
    Part,
    Table,
    fill,
    fill_ghost_rows,
    flow,
    level_index,
)
from ttus_opt.laplace.multigrid.line_smoother import sweep
from ttus_opt.laplace.multigrid.red_black import BLACK, RED, Single
from ttus_opt.laplace.multigrid.transfer import prolong, restrict

#: Least number of nodes of a level that several cores share [–]
LARGE = 2_000_000

#: Sweeps before and after on all levels but the finest, where they cost little and keep
#: the number of cycles from growing with the grid [–]
COARSE_SWEEPS = 2


class Workspace:
    """Vectors that one solve writes to.

    Attributes:
        values: All of them.
        b: The finest level's right-hand side, shape (2, n_r, width).
        x: Its correction, same shape.
        index: Where the finest level's vectors begin.
    """

    def __init__(
        self, hierarchy: Hierarchy, more: int = 0, large: int | None = None
    ) -> None:
        """Allocate the vectors.

        Args:
            hierarchy: The levels.
            more: Further vectors of one colour of the finest level [–].
            large: Least nodes of a level that cores share; None for `LARGE`.
        """
        layout = hierarchy.levels[0].layout
        self._hierarchy = hierarchy
        #: How many cores share each level
        large = LARGE if large is None else large
        sizes = [level.inverse.size for level in hierarchy.levels[:-1]]
        self._parts = [*(parts_of(size, large) for size in sizes), 1]
        scratch = hierarchy.scratch
        vectors = hierarchy.work_size + more * layout.colour_size
        self.values: Single = np.zeros(
            vectors + (max(self._parts) - 1) * scratch, np.float32
        )
        self._levels = [LevelIndex(*row.tolist()) for row in hierarchy.table]
        self.index = self._levels[0]
        self.b = self._vector(self.index.b, layout.stored_shape)
        self.x = self._vector(self.index.x, layout.stored_shape)
        #: Tables of levels for each core, with scratch space of its own
        self._tables = [hierarchy.table]
        for n in range(max(self._parts) - 1):
            own = hierarchy.table.copy()
            own[:, LevelIndex._fields.index("scratch")] = vectors + n * scratch
            self._tables.append(own)

    def _vector(self, start: int, shape: tuple[int, ...]) -> Single:
        """The part of ``values`` that begins somewhere."""
        return self.values[start : start + math.prod(shape)].reshape(shape)

    def v_cycle(self, *, sweeps: int = 1, has_red: bool = True, n: int = 0) -> None:
        """Set ``x`` to one V-cycle's answer for ``b``.

        As the compiled `v_cycle`, large levels shared.

        Args:
            sweeps: Sweeps before and after on level n [–].
            has_red: Whether red nodes have a load.
            n: The level to begin with.
        """
        h, at = self._hierarchy, self._levels[n]
        if self._parts[n] == 1:
            args = h.table[n:], h.fields, self.values, h.places, h.inverse
            v_cycle(*args, sweeps, has_red)
            return
        size = at.n_r * at.width
        if at.n_theta % 2:
            self.values[at.x : at.x + 2 * size] = 0.0
        red = at.b if has_red else at.zeros
        given = at.zeros
        for k in range(sweeps):
            self._sweep(n, BLACK, at.x, given, at.b + size)
            self._sweep(n, RED, at.x, at.x + size, red)
            self._flow(n, at.residual, at.x, -1.0 if k else 0.0)
            given = at.x
        in_parts(self._transfer(n, _restrict), self._parts[n])
        self.v_cycle(sweeps=COARSE_SWEEPS, n=n + 1)
        in_parts(self._transfer(n, _prolong), self._parts[n])
        _fill_ghosts(h.table[n], self.values, at.x, BLACK)
        for _ in range(sweeps):
            self._sweep(n, RED, at.x, at.x + size, red)
            self._sweep(n, BLACK, at.x, at.x, at.b + size)

    def _transfer(self, n: int, kernel: Callable[..., None]) -> Callable[[Part], None]:
        """A transfer between levels n and n + 1, a part at a time."""
        fields, values = self._hierarchy.fields, self.values

        def work(part: Part) -> None:
            table = self._tables[part[0]]
            kernel(table[n], table[n + 1], fields, values, part)

        return work

    def _sweep(self, n: int, colour: int, x: int, opposite: int, load: int) -> None:
        """See `line_smoother.sweep`."""
        h, values = self._hierarchy, self.values
        row, vectors = h.table[n], (colour, x, opposite, load)
        in_parts(partial(sweep, row, h.fields, values, *vectors), self._parts[n])
        if self._parts[n] > 1:
            _fill_ghosts(row, values, x, colour)

    def _flow(self, n: int, out: int, opposite: int, kept: float) -> None:
        """See `kernels.flow`."""
        h, values = self._hierarchy, self.values
        row, given = h.table[n], (out, opposite, kept)
        in_parts(partial(flow, row, h.fields, values, *given), self._parts[n])


@compiled(nogil=True)
def _restrict(
    row: NDArray[np.int64],
    below: NDArray[np.int64],
    fields: Single,
    work: Single,
    part: Part,
) -> None:
    """`transfer.restrict` (compiled)."""
    restrict(level_index(row), level_index(below), fields, work, part)


@compiled(nogil=True)
def _prolong(
    row: NDArray[np.int64],
    below: NDArray[np.int64],
    fields: Single,
    work: Single,
    part: Part,
) -> None:
    """`transfer.prolong` (compiled)."""
    prolong(level_index(row), level_index(below), fields, work, part)


@compiled(nogil=True)
def _fill_ghosts(row: NDArray[np.int64], work: Single, x: int, colour: int) -> None:
    """`kernels.fill_ghost_rows` (compiled)."""
    fill_ghost_rows(level_index(row), work, x, colour)


@compiled(nogil=True)
def v_cycle(
    table: Table,
    fields: Single,
    work: Single,
    places: NDArray[np.int64],
    inverse: Single,
    sweeps: int,
    has_red: bool,
) -> None:
    """Set the finest level's correction to a V-cycle's from zero (compiled).

    Args:
        table: A `LevelIndex` per level, from fine to coarse.
        fields: Coefficients of all levels.
        work: Vectors of all levels.
        places: Flat places of the coarsest level's unknowns.
        inverse: Inverse of the coarsest level's matrix [1/m].
        sweeps: Before and after on the finest level [–].
        has_red: Whether the finest right-hand side has red values; if not, they count
            as zero whatever is stored.
    """
    last = len(table) - 1
    whole = (np.int64(0), np.int64(1))
    for n in range(last):
        at = level_index(table[n])
        size = at.n_r * at.width
        if at.n_theta % 2:  # at θ = 0 a sweep then reads old values of its own colour
            fill(work, at.x, np.float32(0), 2 * size)
        red = at.b if n or has_red else at.zeros
        given = at.zeros
        for k in range(COARSE_SWEEPS if n else sweeps):
            for c in range(1, -1, -1):
                other, load = (given, at.b + size) if c else (at.x + size, red)
                sweep(table[n], fields, work, c, at.x, other, load, whole)
            kept = -1.0 if k else 0.0
            flow(table[n], fields, work, at.residual, at.x, kept, whole)
            given = at.x
        restrict(at, level_index(table[n + 1]), fields, work, whole)
    _solve_coarsest(level_index(table[last]), work, places, inverse, last or has_red)
    for n in range(last - 1, -1, -1):
        at = level_index(table[n])
        size = at.n_r * at.width
        prolong(at, level_index(table[n + 1]), fields, work, whole)
        fill_ghost_rows(at, work, at.x, np.int64(1))
        red = at.b if n or has_red else at.zeros
        for _ in range(COARSE_SWEEPS if n else sweeps):
            for c in range(2):
                other, load = (at.x, at.b + size) if c else (at.x + size, red)
                sweep(table[n], fields, work, c, at.x, other, load, whole)


@compiled(inner=True, nogil=True, fastmath=FAST)
def _solve_coarsest(
    at: LevelIndex,
    work: Single,
    places: NDArray[np.int64],
    inverse: Single,
    has_red: bool,
) -> None:
    """Solve the coarsest level by the inverse of its matrix (compiled)."""
    first = 0 if has_red else at.n_r * at.width
    load = np.uint64(at.scratch)
    for n in range(np.uint64(places.size)):
        used = places[n] >= first
        work[load + n] = work[at.b + places[n]] if used else np.float32(0)
    for n in range(places.size):
        total = np.float32(0)
        for m in range(np.uint64(places.size)):
            total += inverse[n, m] * work[load + m]
        work[at.x + places[n]] = total
    for colour in range(2):
        fill_ghost_rows(at, work, at.x, colour)
