"""Compiled kernels of the multigrid: the index of a level, and loops over vectors.

All coefficients of a hierarchy lie in one array, ``fields``; all vectors of a solve lie
in another, ``work``. A `LevelIndex` holds their offsets, in red-black order
(`red_black`). This keeps compiling short: a function of two flat arrays compiles in a
fraction of the time of one of ten arrays and their slices. Places are unsigned in
loops: a signed index may be negative, which every access would have to check. A
constant colour is passed as ``np.int64``: numba compiles a function again for every
literal argument.

Kernels release the interpreter's lock: several solves may run side by side, and on
large grids several cores share one (`workspace`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.compiled import compiled
from ttus_opt.laplace.multigrid.red_black import Single

FAST = {"contract", "reassoc"}  # sums may be reordered; NaN and inf keep their sense

#: Sizes and offsets of all levels, a `LevelIndex` per row
Table = NDArray[np.int64]

#: Which part of the work, of how many parts
Part = tuple[int, int]


class LevelIndex(NamedTuple):
    """Sizes of a level, and the offsets of its arrays.

    Attributes:
        n_r: Layers [–].
        width: Places per layer and colour [–].
        n_theta: Spokes [–].
        n_z: Slices [–].
        pitch: Distance between spokes in the plane's numbering [–].
        coarsens_r: Whether the next level has half the layers, 0 or 1.
        coarsens_theta: Likewise the spokes.
        coarsens_z: Likewise the slices.
        varies_r: Whether conductances along r vary within a layer, 0 or 1.
        varies: Whether all do; else there is one per layer and direction.
        along: In ``fields``: conductances along r, one per layer, as without blocks;
            on the finest level only [m].
        own: Screening on the diagonal, one number per layer; likewise [m].
        R: Conductances to the next layer [m].
        T: Conductances to the next spoke [m].
        Z: Conductances to the next slice [m].
        inverse: Inverse pivots of the radial lines, zero at fixed nodes [1/m].
        before_r: Interpolation weights of the node before, along r [–].
        after_r: Likewise of the node after.
        before_theta: Likewise along θ.
        after_theta: Likewise.
        before_z: Likewise along z.
        after_z: Likewise.
        b: In ``work``: the right-hand side.
        x: The correction.
        residual: The residual of black nodes.
        zeros: As many zeros as a row and its neighbours have; passed in place of a
            vector, they stand for a vector of zeros.
        scratch: Scratch space of transfers.
    """

    n_r: int
    width: int
    n_theta: int
    n_z: int
    pitch: int
    coarsens_r: int
    coarsens_theta: int
    coarsens_z: int
    varies_r: int
    varies: int
    along: int
    own: int
    R: int
    T: int
    Z: int
    inverse: int
    before_r: int
    after_r: int
    before_theta: int
    after_theta: int
    before_z: int
    after_z: int
    b: int
    x: int
    residual: int
    zeros: int
    scratch: int


@compiled(inner=True, nogil=True)
def level_index(row: NDArray[np.int64]) -> LevelIndex:
    """A `LevelIndex` from its row of a table (compiled)."""
    # fmt: off
    return LevelIndex(
        row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9],
        row[10], row[11], row[12], row[13], row[14], row[15], row[16], row[17], row[18],
        row[19], row[20], row[21], row[22], row[23], row[24], row[25], row[26],
    )
    # fmt: on


@compiled(inner=True, nogil=True)
def bounds(first: int, last: int, part: Part) -> tuple[int, int]:
    """First of a part of first to last, and the one after its last (compiled)."""
    which, parts = part
    size = last - first
    return first + which * size // parts, first + (which + 1) * size // parts


@compiled(inner=True, nogil=True)
def span(at: LevelIndex, colour: int) -> tuple[int, int]:
    """First place of one colour without ghost rows, and the place after the last."""
    return (
        (at.pitch - colour + 1) // 2,
        ((at.n_theta + 1) * at.pitch - colour + 1) // 2,
    )


@compiled(inner=True, nogil=True)
def fill(work: Single, out: int, value: np.float32, count: int) -> None:
    """Set ``count`` values of ``work`` (compiled)."""
    start = np.uint64(out)
    for n in range(np.uint64(count)):
        work[start + n] = value


@compiled(inner=True, nogil=True)
def copy(work: Single, out: int, source: int, count: int) -> None:
    """Copy ``count`` values within ``work`` (compiled)."""
    to, start = np.uint64(out), np.uint64(source)
    for n in range(np.uint64(count)):
        work[to + n] = work[start + n]


@compiled(inner=True, nogil=True)
def fill_ghost_rows(at: LevelIndex, work: Single, x: int, colour: int) -> None:
    """Update the ghost rows that make θ periodic from one colour (compiled).

    With an odd number of spokes a ghost row has the other colour than its original.

    Args:
        at: The level.
        work: Vectors.
        x: Where red values begin; black ones follow.
        colour: Colour whose values have changed.
    """
    turn = at.n_theta * at.pitch
    target = (colour + turn) % 2
    low, high = span(at, target)
    end = ((at.n_theta + 2) * at.pitch - target + 1) // 2
    up = (target + turn - colour) // 2
    down = (turn + colour - target) // 2
    for i in range(1, at.n_r - 1):
        source = x + (colour * at.n_r + i) * at.width
        out = x + (target * at.n_r + i) * at.width
        copy(work, out, source + up, low)
        copy(work, out + high, source + high - down, end - high)


class Rows(NamedTuple):
    """Offsets of the rows of one layer in ``work``, and of pivots in ``fields``.

    Attributes:
        out: The result.
        load: The right-hand side.
        west: The other colour, previous slice.
        east: Next slice.
        south: Previous spoke.
        north: Next spoke.
        inverse: Inverse pivots.
        size: How many values there are.
    """

    out: np.uint64
    load: np.uint64
    west: np.uint64
    east: np.uint64
    south: np.uint64
    north: np.uint64
    inverse: np.uint64
    size: np.uint64


class Links(NamedTuple):
    """Offsets of the conductances of one row's links in ``fields``.

    Attributes:
        west: To the previous slice.
        east: To the next slice.
        south: To the previous spoke.
        north: To the next spoke.
    """

    west: np.uint64
    east: np.uint64
    south: np.uint64
    north: np.uint64


@compiled(inner=True, nogil=True)
def rows_of(
    at: LevelIndex, colour: int, p: int, out: int, opposite: int, load: int, count: int
) -> Rows:
    """Rows at place p of a colour's layers (compiled).

    Args:
        at: The level.
        colour: Colour of the result.
        p: Layer · width + place in the layer.
        out: Where the result begins.
        opposite: Where values of the other colour begin.
        load: Where the right-hand side begins.
        count: How many values there are.
    """
    q = at.pitch // 2
    west = east = south = north = at.zeros
    if opposite != at.zeros:
        y = opposite + p + colour
        west, east, south, north = y - 1, y, y - q - 1, y + q
    return Rows(
        np.uint64(out + p),
        np.uint64(load + p if load != at.zeros else load),
        np.uint64(west),
        np.uint64(east),
        np.uint64(south),
        np.uint64(north),
        np.uint64(at.inverse + colour * at.n_r * at.width + p),
        np.uint64(count),
    )


@compiled(inner=True, nogil=True)
def links_of(at: LevelIndex, colour: int, p: int) -> Links:
    """Links of the row at place p of a colour's layers (compiled)."""
    size, q = at.n_r * at.width, at.pitch // 2
    own, other = colour * size + p, (1 - colour) * size + p + colour
    return Links(
        np.uint64(at.Z + other - 1),
        np.uint64(at.Z + own),
        np.uint64(at.T + other - q - 1),
        np.uint64(at.T + own),
    )


@compiled(inner=True, nogil=True, fastmath=FAST)
def _flow(
    work: Single,
    fields: Single,
    rows: Rows,
    z: np.float32,
    t: np.float32,
    kept: np.float32,
) -> None:
    """Set the flow into free nodes plus ``kept`` times the old value (compiled)."""
    for n in range(rows.size):
        flow = z * (work[rows.west + n] + work[rows.east + n])
        flow += t * (work[rows.south + n] + work[rows.north + n])
        flow += kept * work[rows.out + n]
        work[rows.out + n] = flow if fields[rows.inverse + n] != 0 else np.float32(0)


@compiled(inner=True, nogil=True, fastmath=FAST)
def _flow_varying(
    work: Single, fields: Single, rows: Rows, links: Links, kept: np.float32
) -> None:
    """The same with a conductance for every link, zero at fixed nodes (compiled)."""
    for n in range(rows.size):
        flow = fields[links.west + n] * work[rows.west + n]
        flow += fields[links.east + n] * work[rows.east + n]
        flow += fields[links.south + n] * work[rows.south + n]
        flow += fields[links.north + n] * work[rows.north + n]
        work[rows.out + n] = flow + kept * work[rows.out + n]


@compiled(nogil=True)
def flow(
    row: NDArray[np.int64],
    fields: Single,
    work: Single,
    out: int,
    opposite: int,
    kept: float,
    part: Part,
) -> None:
    """Flow into black nodes from red ones (compiled).

    After one sweep from zero, black lines first, this is the residual of the black
    nodes; after a further sweep it is the change of that residual.

    Args:
        row: The level.
        fields: Coefficients.
        work: Vectors.
        out: Where the result begins, n_r · width values.
        opposite: Where red values begin.
        kept: Factor of the old value of the result [–].
        part: Range of layers.
    """
    at, black, factor = level_index(row), np.int64(1), np.float32(kept)
    first, last = span(at, black)
    low, high = bounds(1, at.n_r - 1, part)
    for i in range(low, high):
        p = i * at.width + first
        rows = rows_of(at, black, p, out, opposite, at.zeros, last - first)
        if at.varies:
            _flow_varying(work, fields, rows, links_of(at, black, p), factor)
        else:
            _flow(work, fields, rows, fields[at.Z + i], fields[at.T + i], factor)
