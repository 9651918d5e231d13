"""Conjugate gradients in single precision, preconditioned by a V-cycle.

As red nodes follow exactly from black ones, conjugate gradients run on black nodes
alone (the Schur complement), unless an odd number of spokes spoils the colouring.
Pooled blocks lie in lines of one colour, which are solved exactly, so that this holds
for them too.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ttus_opt.compiled import compiled
from ttus_opt.multigrid.hierarchy import Hierarchy, Workspace
from ttus_opt.multigrid.kernels import (
    FAST,
    Rows,
    flow,
    level_index,
    rows_of,
    span,
)
from ttus_opt.multigrid.line_smoother import sweep
from ttus_opt.multigrid.pooled_blocks import PooledBlocks, pool
from ttus_opt.multigrid.red_black import BLACK, RED, Single


class Vectors(Workspace):
    """What one solve writes to: conjugate gradients beside the V-cycle.

    Attributes:
        answer: Correction in red-black order, shape (2, n_r, width).
    """

    def __init__(
        self, hierarchy: Hierarchy, blocks: PooledBlocks | None = None
    ) -> None:
        """Take memory.

        Args:
            hierarchy: The levels.
            blocks: Voxels that move as one; None where there are none.
        """
        super().__init__(hierarchy, more=6)
        layout = hierarchy.levels[0].layout
        size = layout.colour_size
        # where red and black values of every vector begin
        self._b, self._x, self._e, self._p, self._q = (
            (start, start + size)
            for start in (
                self.index.b,
                self.index.x,
                *(hierarchy.work_size + n * size for n in (0, 2, 4)),
            )
        )
        self.answer = self._vector(self._e[RED], layout.stored_shape)
        self._direction = self._vector(self._p[RED], layout.stored_shape)
        self._is_odd = hierarchy.levels[0].is_odd
        self._colours = (RED, BLACK) if self._is_odd else (BLACK,)
        edge = np.searchsorted(hierarchy.cut, size)
        self._cuts = tuple(
            (hierarchy.cut[part] - c * size, hierarchy.cut_grounds[part])
            for c, part in ((RED, slice(edge)), (BLACK, slice(edge, None)))
        )
        self._blocks = None
        if blocks is not None:
            followers, leaders = blocks.places(layout, self.index.b)
            used = followers >= self._b[self._colours[0]]
            self._blocks = (followers[used], leaders[used])

    def correct(self, goal: float, limit: int) -> int:
        """Solve A e = ``b`` to a low accuracy; ``b`` becomes the residual.

        The answer e is left in ``answer``.

        Args:
            goal: Relative residual to reach [–].
            limit: Most V-cycles [–].

        Returns:
            V-cycles spent.
        """
        self.answer.fill(0.0)
        self._direction.fill(0.0)
        if not self._is_odd:  # what red loads do to black nodes
            self._relax_red(self._x, self.index.zeros, self._b[RED])
            flow(*self._arrays, self._b[BLACK], self._x[RED], 1.0)
        self._pool()
        first = self._dot(self._b, self._b)
        spent, before = 0, math.inf
        while first > 0.0 and spent < limit:
            spent += 1
            self.v_cycle(has_red=self._is_odd)
            rz = self._dot(self._b, self._x)
            for c in self._colours:
                extend(self.values, self._p[c], self._x[c], rz / before, *self._sizes)
            pq = self._operate()
            if not (pq > 0.0 and rz > 0.0):  # down to rounding
                break
            now = self._step(rz / pq)
            if self._blocks is not None:
                self._pool()
                now = self._dot(self._b, self._b)
            if now <= goal**2 * first:
                break
            before = rz
        if not self._is_odd:
            self._relax_red(self._e, self._e[BLACK], self._b[RED])
        return spent

    def _operate(self) -> float:
        """Set q = A p; returns p · q."""
        if self._is_odd:
            others = self._p
        else:  # red values that follow from black ones
            others = self._x
            self._relax_red(self._x, self._p[BLACK], self.index.zeros)
        total = [
            operate(*self._arrays, c, self._q[c], self._p[c], others[1 - c])
            for c in self._colours
        ]
        total += [
            add_grounds(self.values, *self._cuts[c], self._q[c], self._p[c])
            for c in self._colours
        ]
        return math.fsum(total)

    def _step(self, alpha: float) -> float:
        """Set e += α p and b -= α q; returns b · b."""
        vectors = (self._e, self._b, self._p, self._q)
        return math.fsum(
            step(self.values, *(v[c] for v in vectors), alpha, *self._sizes)
            for c in self._colours
        )

    def _dot(self, a: tuple[int, int], b: tuple[int, int]) -> float:
        return math.fsum(
            dot(self.values, a[c], b[c], *self._sizes) for c in self._colours
        )

    def _relax_red(self, x: tuple[int, int], opposite: int, load: int) -> None:
        sweep(*self._arrays, RED, x[RED], opposite, load)

    def _pool(self) -> None:
        if self._blocks is not None:
            pool(self.values, *self._blocks)


# Loops run over closing rows too: there, b and q are zero and p is a copy.


@compiled(nogil=True, fastmath=FAST)
def dot(work: Single, a: int, b: int, n_r: int, width: int) -> float:
    """Sum of a · b over one colour; rows are added in double precision (compiled)."""
    total = 0.0
    for start in range(0, n_r * width, width):
        first, second = np.uint64(a + start), np.uint64(b + start)
        part = np.float32(0)
        for n in range(np.uint64(width)):
            part += work[first + n] * work[second + n]
        total += float(part)
    return total


@compiled(nogil=True, fastmath=FAST)
def extend(work: Single, p: int, z: int, beta: float, n_r: int, width: int) -> None:
    """Set p = z + β p, the next direction, for one colour (compiled)."""
    own, new, factor = np.uint64(p), np.uint64(z), np.float32(beta)
    for n in range(np.uint64(n_r * width)):
        work[own + n] = work[new + n] + factor * work[own + n]


@compiled(nogil=True, fastmath=FAST)
def step(
    work: Single, e: int, r: int, p: int, q: int, alpha: float, n_r: int, width: int
) -> float:
    """Set e += α p and r -= α q for one colour; returns r · r (compiled)."""
    factor, total = np.float32(alpha), 0.0
    for start in range(0, n_r * width, width):
        answer, rest = np.uint64(e + start), np.uint64(r + start)
        along, image = np.uint64(p + start), np.uint64(q + start)
        part = np.float32(0)
        for n in range(np.uint64(width)):
            work[answer + n] += factor * work[along + n]
            left = work[rest + n] - factor * work[image + n]
            work[rest + n] = left
            part += left * left
        total += float(part)
    return total


@compiled(inner=True, nogil=True, fastmath=FAST)
def _row_operate(
    work: Single,
    fields: Single,
    rows: Rows,
    along: tuple[np.uint64, np.uint64],
    r: tuple[np.float32, np.float32],
    z: np.float32,
    t: np.float32,
    screening: np.float32,
) -> np.float32:
    """One layer of A p, p at ``rows.load``; returns its p · A p (compiled)."""
    (inner, outer), (r_in, r_out) = along, r
    total = np.float32(0)
    diagonal = r_in + r_out + np.float32(2) * (z + t) + screening
    for n in range(rows.size):
        own = work[rows.load + n]
        value = diagonal * own - r_in * work[inner + n] - r_out * work[outer + n]
        value -= z * (work[rows.west + n] + work[rows.east + n])
        value -= t * (work[rows.south + n] + work[rows.north + n])
        value = value if fields[rows.inverse + n] != 0 else np.float32(0)
        work[rows.out + n] = value
        total += value * own
    return total


@compiled(nogil=True)
def operate(
    row: NDArray[np.int64],
    fields: Single,
    work: Single,
    colour: int,
    out: int,
    own: int,
    opposite: int,
) -> float:
    """Rows of one colour of A p on the finest level; returns their p · A p (compiled).

    Within a block nothing flows, as all its voxels have one value: conductances along
    r are those without blocks.

    Args:
        row: The finest level.
        fields: Coefficients.
        work: Vectors.
        colour: 0 (red) or 1 (black).
        out: Where the result begins.
        own: Where p of this colour begins.
        opposite: Where p of the other colour begins.
    """
    at = level_index(row)
    first, last = span(at, colour)
    total = 0.0
    for i in range(1, at.n_r - 1):
        p = i * at.width + first
        rows = rows_of(at, colour, p, out, opposite, own, last - first)
        along = np.uint64(own + p - at.width), np.uint64(own + p + at.width)
        r = fields[at.along + i - 1], fields[at.along + i]
        z, t, screening = fields[at.Z + i], fields[at.T + i], fields[at.own + i]
        total += _row_operate(work, fields, rows, along, r, z, t, screening)
    return total


@compiled(nogil=True)
def add_grounds(
    work: Single, places: NDArray[np.int64], grounds: Single, out: int, own: int
) -> float:
    """Add to A p what some nodes have on their diagonal; returns p · that (compiled).

    Args:
        work: Vectors.
        places: Nodes of one colour, shape (k,).
        grounds: What is added to their diagonal, shape (k,) [m].
        out: Where A p begins.
        own: Where p begins.
    """
    total = 0.0
    for n in range(places.size):
        value = work[own + places[n]]
        work[out + places[n]] += grounds[n] * value
        total += float(grounds[n] * value * value)
    return total
