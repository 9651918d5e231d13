"""Red-black zebra line relaxation: radial lines, solved exactly, one colour at a time.

Lines of one colour do not touch (Trottenberg, Oosterlee and Schüller, Multigrid, 2001,
section 5.1), and Thomas' algorithm runs over many of them side by side in the vector
registers. Fixed nodes have a zero inverse pivot: they stay zero and separate the
lines without a branch. Arrays are those of `kernels`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.core.compiled import compiled
from ttus_opt.laplace.multigrid.kernels import (
    FAST,
    LevelIndex,
    Links,
    Part,
    Rows,
    bounds,
    fill_ghost_rows,
    level_index,
    links_of,
    rows_of,
    span,
)
from ttus_opt.laplace.multigrid.red_black import Single

#: Lines solved side by side; a block of them stays in the second-level cache.
TILE = 1024


def inverse_pivots(aside: Single, R: Single) -> Single:
    """Inverse pivots of Thomas' algorithm for every line.

    A node is grounded by the conductances of its own row outside the line and, through
    the link in series, by the part of the line before it. No differences are formed, so
    that stiff links cost the others no digits.

    Args:
        aside: Diagonal of the operator without links along lines, zero at fixed nodes
            and nowhere else, shape (2, n_r, width) [m].
        R: Conductances to the next layer, same shape or (n_r,) [m].

    Returns:
        Same shape as ``aside``, zero at fixed nodes [1/m].
    """
    inverse = np.zeros_like(aside)
    links = R if R.ndim > 1 else R[None, :, None]
    _invert_pivots(inverse, aside, links, np.zeros(aside.shape[2]))
    return inverse


@compiled(nogil=True)
def _invert_pivots(inverse: Single, aside: Single, R: Single, held: Array) -> None:
    """Set ``inverse`` of `inverse_pivots` (compiled).

    R has three dimensions; ``held`` is scratch, one number a line [m].
    """
    own_r = 1 if R.shape[2] > 1 else 0
    for c in range(2):
        for h in range(held.size):
            held[h] = 0.0
        for i in range(1, aside.shape[1] - 1):
            for h in range(held.size):
                own = np.float64(aside[c, i, h])
                if own > 0.0:
                    if held[h] > 0.0:
                        r = np.float64(R[c * own_r, i - 1, h * own_r])
                        own += r * held[h] / (r + held[h])
                    ahead = np.float32(0)
                    if aside[c, i + 1, h] > 0.0:
                        ahead = R[c * own_r, i, h * own_r]
                    inverse[c, i, h] = 1.0 / (own + ahead)
                held[h] = own


@compiled(inner=True, nogil=True, fastmath=FAST)
def _forward(
    work: Single,
    fields: Single,
    rows: Rows,
    inner: np.uint64,
    r: np.float32,
    z: np.float32,
    t: np.float32,
) -> None:
    """Elimination in one layer, conductances r, z, t of the layer (compiled)."""
    for n in range(rows.size):
        load = work[rows.load + n] + z * (work[rows.west + n] + work[rows.east + n])
        load += t * (work[rows.south + n] + work[rows.north + n])
        load += r * work[inner + n]
        work[rows.out + n] = load * fields[rows.inverse + n]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _forward_varying_r(
    work: Single,
    fields: Single,
    rows: Rows,
    inner: np.uint64,
    R: np.uint64,
    z: np.float32,
    t: np.float32,
) -> None:
    """The same with a conductance for every link along r (compiled)."""
    for n in range(rows.size):
        load = work[rows.load + n] + z * (work[rows.west + n] + work[rows.east + n])
        load += t * (work[rows.south + n] + work[rows.north + n])
        load += fields[R + n] * work[inner + n]
        work[rows.out + n] = load * fields[rows.inverse + n]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _forward_varying(
    work: Single,
    fields: Single,
    rows: Rows,
    inner: np.uint64,
    R: np.uint64,
    links: Links,
) -> None:
    """The same with a conductance for every link (compiled)."""
    for n in range(rows.size):
        load = work[rows.load + n] + fields[links.west + n] * work[rows.west + n]
        load += fields[links.east + n] * work[rows.east + n]
        load += fields[links.south + n] * work[rows.south + n]
        load += fields[links.north + n] * work[rows.north + n]
        load += fields[R + n] * work[inner + n]
        work[rows.out + n] = load * fields[rows.inverse + n]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _back(
    work: Single,
    fields: Single,
    out: np.uint64,
    outer: np.uint64,
    inverse: np.uint64,
    r: np.float32,
    count: np.uint64,
) -> None:
    """Back substitution in one layer (compiled)."""
    for n in range(count):
        work[out + n] += r * fields[inverse + n] * work[outer + n]


@compiled(inner=True, nogil=True, fastmath=FAST)
def _back_varying_r(
    work: Single,
    fields: Single,
    out: np.uint64,
    outer: np.uint64,
    inverse: np.uint64,
    R: np.uint64,
    count: np.uint64,
) -> None:
    """The same with a conductance for every link along r (compiled)."""
    for n in range(count):
        work[out + n] += fields[R + n] * fields[inverse + n] * work[outer + n]


@compiled(inline="always")
def _solve_tile(
    at: LevelIndex,
    fields: Single,
    work: Single,
    colour: int,
    vectors: tuple[int, int, int],
    s: int,
    count: int,
) -> None:
    """Solve the lines of places s to s + count (compiled)."""
    out, opposite, load = vectors
    R = at.R + colour * at.n_r * at.width
    for i in range(1, at.n_r - 1):
        p = i * at.width + s
        rows = rows_of(at, colour, p, out, opposite, load, count)
        inner, along = np.uint64(out + p - at.width), np.uint64(R + p - at.width)
        if at.varies and opposite != at.zeros:
            links = links_of(at, colour, p)
            _forward_varying(work, fields, rows, inner, along, links)
        else:
            z, t = fields[at.Z + i], fields[at.T + i]
            if at.varies_r:
                _forward_varying_r(work, fields, rows, inner, along, z, t)
            else:
                _forward(work, fields, rows, inner, fields[at.R + i - 1], z, t)
    inverse = at.inverse + colour * at.n_r * at.width
    for i in range(at.n_r - 3, 0, -1):
        p = i * at.width + s
        own, outer = np.uint64(out + p), np.uint64(out + p + at.width)
        pivot, n = np.uint64(inverse + p), np.uint64(count)
        if at.varies_r:
            _back_varying_r(work, fields, own, outer, pivot, np.uint64(R + p), n)
        else:
            _back(work, fields, own, outer, pivot, fields[at.R + i], n)


@compiled(nogil=True)
def sweep(
    row: NDArray[np.int64],
    fields: Single,
    work: Single,
    colour: int,
    x: int,
    opposite: int,
    load: int,
    part: Part,
) -> None:
    """Solve every radial line of one colour, given the other colour (compiled).

    With several parts, the caller updates the ghost rows once all are done.

    Args:
        row: The level.
        fields: Coefficients.
        work: Vectors.
        colour: 0 (red) or 1 (black).
        x: Where red values of the result begin; black ones follow.
        opposite: Where values of the other colour begin.
        load: Where the right-hand side of this colour begins.
        part: Range of tiles.
    """
    at = level_index(row)
    out = x + colour * at.n_r * at.width
    first, last = span(at, colour)
    low, high = bounds(0, (last - first + TILE - 1) // TILE, part)
    for tile in range(low, high):
        s = first + tile * TILE
        count = min(TILE, last - s)
        _solve_tile(at, fields, work, colour, (out, opposite, load), s, count)
    if part[1] == 1:
        fill_ghost_rows(at, work, x, colour)
