"""One symmetric V-cycle on all levels, in one call of compiled code.

On a small grid each kernel takes microseconds: with Python in between, solves side by
side would spend their time waiting for the interpreter's lock.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.compiled import compiled
from ttus_opt.laplace.multigrid.kernels import (
    FAST,
    LevelIndex,
    Table,
    fill,
    fill_ghost_rows,
    flow,
    level_index,
)
from ttus_opt.laplace.multigrid.line_smoother import sweep
from ttus_opt.laplace.multigrid.red_black import Single
from ttus_opt.laplace.multigrid.transfer import prolong, restrict

#: Sweeps before and after on all levels but the finest, where they cost little and keep
#: the number of cycles from growing with the grid [–]
COARSE_SWEEPS = 2


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
