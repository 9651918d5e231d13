"""Weighted measured rows D that grow and shrink, one block of rows per measurement.

The rows of one pose touch the same voxels (`ttus_opt.contact.rows`), so a block is a
list of voxels with m numbers each, with a third to a sixth of the indices of a sparse
matrix.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.core.compiled import compiled

Voxels = NDArray[np.int32]

#: Entries allocated at first
ROOM = 4096


@dataclass(frozen=True)
class Block:
    """Rows of one pose.

    Attributes:
        voxels: Flat indices, increasing, shape (j,).
        values: The rows' columns at these voxels, shape (j, m).
    """

    voxels: Voxels
    values: Array


class MeasuredRows:
    """D, of k blocks of m rows, over V voxels; row m·s + c is row c of block s.

    Args:
        n_voxels: V [–].
        height: Rows per block, m [–].
    """

    def __init__(self, n_voxels: int, height: int) -> None:
        self.n_voxels = n_voxels
        self._height = height
        self._starts = np.zeros(1, dtype=np.int64)
        self._voxels = np.empty(ROOM, dtype=np.int32)
        self._values = np.empty((ROOM, height))

    def __len__(self) -> int:
        """Number of blocks k [–]."""
        return len(self._starts) - 1

    @property
    def memory_bytes(self) -> int:
        """Size of the arrays, space to grow included."""
        return self._starts.nbytes + self._voxels.nbytes + self._values.nbytes

    def append(self, block: Block) -> None:
        """Add a block."""
        voxels, values = block.voxels, block.values
        used = int(self._starts[-1])
        end = used + len(voxels)
        if end > len(self._voxels):
            self._resize(max(2 * len(self._voxels), end))
        self._voxels[used:end] = voxels
        self._values[used:end] = values
        self._starts = np.append(self._starts, end)

    def keep(self, blocks: NDArray[np.int64]) -> None:
        """Keep only these blocks, given by increasing numbers."""
        counts, end = np.diff(self._starts)[blocks], 0
        for s, count in zip(blocks, counts, strict=True):
            start, new = int(self._starts[s]), slice(end, end + int(count))
            if start != end:
                self._voxels[new] = self._voxels[start : start + count]
                self._values[new] = self._values[start : start + count]
            end = new.stop
        self._starts = np.concatenate([[0], np.cumsum(counts)])
        if len(self._voxels) > 4 * max(end, ROOM):
            self._resize(2 * end)

    def block(self, s: int) -> Block:
        """Block s, as views that are valid until the next change."""
        at = slice(int(self._starts[s]), int(self._starts[s + 1]))
        return Block(self._voxels[at], self._values[at])

    def row(self, i: int) -> tuple[Voxels, Array]:
        """Voxels and values of row i, as views likewise."""
        block = self.block(i // self._height)
        return block.voxels, block.values[:, i % self._height]

    def scale(self, factor: float) -> None:
        """Multiply every row by a number."""
        self._values[: self._starts[-1]] *= factor

    def _resize(self, size: int) -> None:
        voxels, values = self._voxels, self._values
        used = int(self._starts[-1])
        self._voxels = np.empty(size, dtype=np.int32)
        self._values = np.empty((size, self._height))
        self._voxels[:used], self._values[:used] = voxels[:used], values[:used]

    def times(self, x: Array) -> Array:
        """D x for x of shape (V,)."""
        out = np.zeros(len(self) * self._height)
        _times(self._starts, self._voxels, self._values, x, out)
        return out

    def adjoint(self, y: Array) -> Array:
        """Dᵀ y for y of shape (k·m,), shape (V,)."""
        out = np.zeros(self.n_voxels)
        _adjoint(self._starts, self._voxels, self._values, y, out)
        return out


@compiled(nogil=True)
def _times(
    starts: NDArray[np.int64], voxels: Voxels, values: Array, x: Array, out: Array
) -> None:
    """Add D x to out (compiled)."""
    m = values.shape[1]
    for s in range(len(starts) - 1):
        sums = out[s * m : (s + 1) * m]
        for e in range(starts[s], starts[s + 1]):
            value = x[voxels[e]]
            for c in range(m):
                sums[c] += values[e, c] * value


@compiled(nogil=True)
def _adjoint(
    starts: NDArray[np.int64], voxels: Voxels, values: Array, y: Array, out: Array
) -> None:
    """Add Dᵀ y to out (compiled)."""
    m = values.shape[1]
    for s in range(len(starts) - 1):
        part = y[s * m : (s + 1) * m]
        for e in range(starts[s], starts[s + 1]):
            total = 0.0
            for c in range(m):
                total += values[e, c] * part[c]
            out[voxels[e]] += total
