"""Conjugate gradients in single precision, preconditioned by a V-cycle.

Red nodes follow exactly from black ones, so conjugate gradients run on black nodes
alone (the Schur complement), unless an odd number of spokes spoils the colouring. The
same holds with pooled blocks: each lies in one line, and lines are solved exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.core.compiled import compiled
from ttus_opt.core.threads import in_parts
from ttus_opt.laplace.multigrid.hierarchy import Hierarchy
from ttus_opt.laplace.multigrid.kernels import (
    FAST,
    Part,
    Rows,
    bounds,
    level_index,
    rows_of,
    span,
)
from ttus_opt.laplace.multigrid.pooled_blocks import PooledBlocks, pool
from ttus_opt.laplace.multigrid.red_black import BLACK, RED, Single
from ttus_opt.laplace.multigrid.workspace import Workspace


class Vectors(Workspace):
    """Vectors of one solve: those of conjugate gradients beside the V-cycle's.

    Attributes:
        answer: Correction in red-black order, shape (2, n_r, width).
    """

    def __init__(
        self, hierarchy: Hierarchy, blocks: PooledBlocks | None = None
    ) -> None:
        """Allocate the vectors.

        Args:
            hierarchy: The levels.
            blocks: Pooled blocks; None if there are none.
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
        self._sums, self._width = np.zeros(layout.shape[0]), layout.width
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
        if not self._is_odd:  # the effect of red loads on black nodes
            self._sweep(0, RED, self._x[RED], self.index.zeros, self._b[RED])
            self._flow(0, self._b[BLACK], self._x[RED], 1.0)
        if self._blocks is not None:
            pool(self.values, *self._blocks)
        first = self._dot(self._b, self._b)
        spent, before = 0, math.inf
        while first > 0.0 and spent < limit:
            spent += 1
            self.v_cycle(has_red=self._is_odd)
            rz = self._dot(self._b, self._x)
            for c in self._colours:  # p = x + β p
                vectors = self._p[c], self._x[c], rz / before
                self._run(extend, self.values, *vectors, self._sums.size * self._width)
            pq = self._operate()
            if not (pq > 0.0 and rz > 0.0):  # down to rounding
                break
            now = self._step(rz / pq)
            if self._blocks is not None:
                pool(self.values, *self._blocks)
                now = self._dot(self._b, self._b)
            if now <= goal**2 * first:
                break
            before = rz
        if not self._is_odd:
            self._sweep(0, RED, self._e[RED], self._e[BLACK], self._b[RED])
        return spent

    def _operate(self) -> float:
        """Set q = A p; returns p · q."""
        if self._is_odd:
            others = self._p
        else:  # red values that follow from black ones
            others = self._x
            self._sweep(0, RED, self._x[RED], self._p[BLACK], self.index.zeros)
        total, row, fields = 0.0, self._hierarchy.table[0], self._hierarchy.fields
        self._sums.fill(0.0)  # the first layer and the last have none
        for c in self._colours:
            vectors = self._q[c], self._p[c], others[1 - c]
            self._run(operate, row, fields, self.values, c, vectors, self._sums)
            total += math.fsum(self._sums)
            total += add_grounds(self.values, *self._cuts[c], self._q[c], self._p[c])
        return total

    def _step(self, alpha: float) -> float:
        """Set e += α p and b -= α q; returns b · b."""
        total = 0.0
        for c in self._colours:
            vectors = self._e[c], self._b[c], self._p[c], self._q[c]
            self._run(step, self.values, vectors, alpha, self._sums, self._width)
            total += math.fsum(self._sums)
        return total

    def _dot(self, a: tuple[int, int], b: tuple[int, int]) -> float:
        total = 0.0
        for c in self._colours:
            self._run(dot, self.values, a[c], b[c], self._sums, self._width)
            total += math.fsum(self._sums)
        return total

    def _run(self, kernel: Callable[..., None], *args: object) -> None:
        """Call a kernel of the finest level, on several cores if that is large."""
        in_parts(partial(kernel, *args), self._parts[0])


# Loops run over ghost rows too: there, b and q are zero and p is a copy.


@compiled(nogil=True, fastmath=FAST)
def dot(work: Single, a: int, b: int, sums: Array, width: int, part: Part) -> None:
    """Set ``sums`` to a · b in every layer of a part, of one colour (compiled)."""
    low, high = bounds(0, sums.size, part)
    for i in range(low, high):
        first, second = np.uint64(a + i * width), np.uint64(b + i * width)
        total = np.float32(0)
        for n in range(np.uint64(width)):
            total += work[first + n] * work[second + n]
        sums[i] = total


@compiled(nogil=True, fastmath=FAST)
def extend(work: Single, p: int, z: int, beta: float, size: int, part: Part) -> None:
    """Set p = z + β p, the next direction, for a part of one colour (compiled)."""
    low, high = bounds(0, size, part)
    own, new, factor = np.uint64(p + low), np.uint64(z + low), np.float32(beta)
    for n in range(np.uint64(high - low)):
        work[own + n] = work[new + n] + factor * work[own + n]


@compiled(nogil=True, fastmath=FAST)
def step(
    work: Single,
    vectors: tuple[int, int, int, int],
    alpha: float,
    sums: Array,
    width: int,
    part: Part,
) -> None:
    """Set e += α p, r -= α q and ``sums`` to r · r in a part's layers (compiled).

    Args:
        work: Vectors.
        vectors: Where e, r, p and q of one colour begin.
        alpha: α [–].
        sums: Per layer, shape (n_r,).
        width: Places per layer.
        part: Range of layers.
    """
    (e, r, p, q), factor = vectors, np.float32(alpha)
    low, high = bounds(0, sums.size, part)
    for i in range(low, high):
        answer, rest = np.uint64(e + i * width), np.uint64(r + i * width)
        along, image = np.uint64(p + i * width), np.uint64(q + i * width)
        total = np.float32(0)
        for n in range(np.uint64(width)):
            work[answer + n] += factor * work[along + n]
            left = work[rest + n] - factor * work[image + n]
            work[rest + n] = left
            total += left * left
        sums[i] = total


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
    vectors: tuple[int, int, int],
    sums: Array,
    part: Part,
) -> None:
    """Rows of one colour of A p on the finest level (compiled).

    Within a block nothing flows, as all its voxels have one value: conductances along
    r are those without blocks.

    Args:
        row: The finest level.
        fields: Coefficients.
        work: Vectors.
        colour: 0 (red) or 1 (black).
        vectors: Where the result, p of this colour and p of the other colour begin.
        sums: Is set to p · A p in every layer, shape (n_r,).
        part: Range of layers.
    """
    at, (out, own, opposite) = level_index(row), vectors
    first, last = span(at, colour)
    low, high = bounds(1, at.n_r - 1, part)
    for i in range(low, high):
        p = i * at.width + first
        rows = rows_of(at, colour, p, out, opposite, own, last - first)
        along = np.uint64(own + p - at.width), np.uint64(own + p + at.width)
        r = fields[at.along + i - 1], fields[at.along + i]
        z, t, screening = fields[at.Z + i], fields[at.T + i], fields[at.own + i]
        sums[i] = _row_operate(work, fields, rows, along, r, z, t, screening)


@compiled(nogil=True)
def add_grounds(
    work: Single, places: NDArray[np.int64], grounds: Single, out: int, own: int
) -> float:
    """Add the diagonal of cut links to A p; returns its share of p · A p (compiled).

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
