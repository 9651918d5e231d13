"""A Cholesky factor that takes rows in and gives rows back.

The matrix is H = I + K with K symmetric positive semidefinite, rows coming a few at
a time; F Fᵀ = H with F lower triangular. Appending m rows to n costs one forward
substitution, O(m n²); taking m rows out of the middle rotates what stands behind
them, O(m n²) and without subtraction, so that it cannot break down. Both are exact
to rounding. Everything here moves n²/2 numbers through the memory and computes
little, hence plain compiled loops instead of a threaded BLAS; several right sides at
once compute enough for every core to take a share of the rows.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ttus_opt.compiled import compiled
from ttus_opt.errors import InputError, NumericalError

Array = NDArray[np.float64]

#: Rows per piece of memory; growing never copies what is there
CHUNK = 256

#: Cores that share a forward substitution, and known entries from which it pays
CORES, WORTH_SHARING = len(os.sched_getaffinity(0)), 1024

#: Columns of a row that are worked on together, so that they stay in the fast cache
TILE = 512


class GrowingFactor:
    """Lower triangular F with F Fᵀ = H, in chunks of rows.

    Memory is n²/2 numbers of 8 bytes plus half a chunk per row: 208 MB at n = 7,200.
    """

    def __init__(self) -> None:
        self._chunks: list[Array] = []
        self._size = 0

    def __len__(self) -> int:
        """Number of rows n [–]."""
        return self._size

    @property
    def memory_bytes(self) -> int:
        """Size of the chunks."""
        return sum(chunk.nbytes for chunk in self._chunks)

    def forward(self, rows: Array) -> Array:
        """Solve F x = g for several g at once.

        Args:
            rows: One right side g per row, shape (m, n).

        Returns:
            One x per row, shape (m, n).

        Raises:
            InputError: Another length than n.
        """
        x = self._checked(rows, 2)
        with ThreadPoolExecutor(CORES) as pool:
            for start, stop, chunk in self._pieces():
                whole = (stop - start) // 4 * 4
                # rows do not know each other here: each core takes its share of them
                shares = CORES if start >= WORTH_SHARING else 1
                cuts = [whole * k // shares // 4 * 4 for k in range(shares)]
                parts = list(pairwise([*cuts, whole]))
                if shares == 1:
                    _meet(chunk, start, *parts[0], x)
                else:
                    list(pool.map(partial(_meet_part, chunk, start, x), parts))
                _finish(chunk, start, stop - start, x)
        return x

    def backward(self, right_side: Array) -> Array:
        """Solve Fᵀ y = z.

        Args:
            right_side: z, shape (n,).

        Returns:
            y, shape (n,).

        Raises:
            InputError: Another length than n.
        """
        y = self._checked(right_side, 1)
        for start, stop, chunk in reversed(self._pieces()):
            _backward(chunk, start, stop - start, y)
        return y

    def append(self, reduced: Array, corner: Array) -> None:
        """Add m rows.

        Args:
            reduced: F⁻¹ times the new columns of H, transposed, shape (m, n); what
                `forward` gives.
            corner: The new rows' Schur complement, shape (m, m).

        Raises:
            InputError: Shapes that do not fit.
            NumericalError: The Schur complement is not positive definite.
        """
        m = len(corner)
        if reduced.shape != (m, self._size) or corner.shape != (m, m):
            raise InputError(
                f"new rows must be ({m}, {self._size}) with a corner ({m}, {m}), got "
                f"{reduced.shape} and {corner.shape}"
            )
        try:
            root = np.linalg.cholesky(corner)
        except np.linalg.LinAlgError as error:
            raise NumericalError(
                "the new rows' Schur complement is not positive definite: H must be "
                "I + K with K positive semidefinite"
            ) from error
        for a in range(m):
            row = self._grow()
            row[: self._size - a] = reduced[a]
            row[self._size - a : self._size + 1] = root[a, : a + 1]
            self._size += 1

    def truncate(self, size: int) -> None:
        """Drop the last rows; what is left is bit for bit what it was.

        Args:
            size: Rows to keep [–].

        Raises:
            InputError: More rows than there are.
        """
        if not 0 <= size <= self._size:
            raise InputError(f"size must lie in 0 to {self._size}, got {size}")
        self._size = size
        del self._chunks[-(-size // CHUNK) :]

    def remove(self, start: int, count: int) -> None:
        """Take rows and columns start to start + count out of H.

        With F₃₃ and F₃₂ the parts of F behind and below the rows that go, the new
        part behind is the factor of F₃₃F₃₃ᵀ + F₃₂F₃₂ᵀ, made row by row with Givens
        rotations.

        Args:
            start: First row.
            count: Number of rows.

        Raises:
            InputError: Rows that are not there.
        """
        if start < 0 or count < 0 or start + count > self._size:
            raise InputError(
                f"rows {start} to {start + count} are not within 0 to {self._size}"
            )
        left = self._size - count
        cosines = np.empty((max(left - start, 1), count))
        sines = np.empty_like(cosines)
        for j in range(start, left if count else start):
            old, new = self._row(j + count), self._row(j)
            gone = old[start : start + count].copy()
            new[:start] = old[:start]
            new[start : j + 1] = old[start + count : j + count + 1].copy()
            _rotate(new[start : j + 1], gone, cosines, sines)
        self.truncate(left)

    def faded(self, factor: float) -> GrowingFactor:
        """Factor of I + factor · K.

        Costs O(n³) and for a moment three full n × n matrices.

        Args:
            factor: Between 0 and 1 [–].

        Returns:
            A new factor.

        Raises:
            InputError: The factor is not within 0 and 1.
        """
        if not 0.0 <= factor <= 1.0:
            raise InputError(f"factor must lie between 0 and 1, got {factor}")
        out = GrowingFactor()
        if self._size == 0:
            return out
        full = self.dense()
        H = full @ full.T
        # I + s K as s H + (1 - s) I: no difference of large numbers
        H *= factor
        H[np.diag_indices_from(H)] += 1.0 - factor
        for row in np.linalg.cholesky(H):
            out._grow()[: out._size + 1] = row[: out._size + 1]
            out._size += 1
        return out

    def dense(self) -> Array:
        """F as one array with zeros above the diagonal, shape (n, n)."""
        out = np.zeros((self._size, self._size))
        for start, stop, chunk in self._pieces():
            out[start:stop, :stop] = np.tril(chunk[: stop - start, :stop], start)
        return out

    def _checked(self, values: Array, ndim: int) -> Array:
        """A contiguous copy of right sides that fit."""
        x = np.array(values, dtype=np.float64, order="C")
        if x.ndim != ndim or x.shape[-1] != self._size:
            raise InputError(
                f"right sides must have {ndim} dimensions, the last of {self._size}, "
                f"got {x.shape}"
            )
        return x

    def _pieces(self) -> list[tuple[int, int, Array]]:
        """First row, row after the last and memory of every chunk."""
        return [
            (i * CHUNK, min((i + 1) * CHUNK, self._size), chunk)
            for i, chunk in enumerate(self._chunks)
        ]

    def _row(self, j: int) -> Array:
        row: Array = self._chunks[j // CHUNK][j % CHUNK]
        return row

    def _grow(self) -> Array:
        """Memory of the row after the last."""
        if self._size == CHUNK * len(self._chunks):
            # zeros: lazily backed by memory, and nothing undefined in it
            self._chunks.append(np.zeros((CHUNK, self._size + CHUNK)))
        return self._row(self._size)


def _meet_part(chunk: Array, start: int, x: Array, rows: tuple[int, int]) -> None:
    _meet(chunk, start, *rows, x)


@compiled(nogil=True, fastmath={"reassoc", "contract"})
def _meet(chunk: Array, start: int, first: int, last: int, x: Array) -> None:
    """Take what is known off the right sides of a chunk's rows (compiled).

    Slices instead of offsets let the compiler vectorise; four rows at a time halve
    what is read of x.

    Args:
        chunk: The chunk.
        start: Its first row in F, and the number of known entries.
        first: Of its rows, a multiple of 4.
        last: The row after the last, a multiple of 4.
        x: Known entries, then right sides, shape (m, n).
    """
    m = len(x)
    for low in range(0, start, TILE):
        high = min(low + TILE, start)
        for j in range(first, last, 4):
            r0, r1 = chunk[j, low:high], chunk[j + 1, low:high]
            r2, r3 = chunk[j + 2, low:high], chunk[j + 3, low:high]
            for c in range(m):
                known = x[c, low:high]
                s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
                for i in range(len(known)):
                    value = known[i]
                    s0 += value * r0[i]
                    s1 += value * r1[i]
                    s2 += value * r2[i]
                    s3 += value * r3[i]
                at = start + j
                x[c, at] -= s0
                x[c, at + 1] -= s1
                x[c, at + 2] -= s2
                x[c, at + 3] -= s3


@compiled(nogil=True, fastmath={"reassoc", "contract"})
def _finish(chunk: Array, start: int, count: int, x: Array) -> None:
    """Solve a chunk's rows among themselves, in place (compiled)."""
    m = len(x)
    whole = count - count % 4
    for j in range(count):
        # the rows left over from the fours have not met the tiles yet
        low, at = start if j < whole else 0, start + j
        row = chunk[j, low:at]
        for c in range(m):
            known = x[c, low:at]
            total = 0.0
            for i in range(len(row)):
                total += row[i] * known[i]
            x[c, at] = (x[c, at] - total) / chunk[j, at]


@compiled(nogil=True, fastmath={"reassoc", "contract"})
def _backward(chunk: Array, start: int, count: int, y: Array) -> None:
    """One chunk of Fᵀ y = z, in place (compiled)."""
    own = y[start : start + count]
    for j in range(count - 1, -1, -1):
        value = own[j] / chunk[j, start + j]
        own[j] = value
        row = chunk[j, start : start + j]
        for i in range(len(row)):
            own[i] -= value * row[i]
    whole = count - count % 4
    for low in range(0, start, TILE):
        part = y[low : min(low + TILE, start)]
        high = low + len(part)
        for j in range(0, whole, 4):
            r0, r1 = chunk[j, low:high], chunk[j + 1, low:high]
            r2, r3 = chunk[j + 2, low:high], chunk[j + 3, low:high]
            v0, v1, v2, v3 = own[j], own[j + 1], own[j + 2], own[j + 3]
            for i in range(len(part)):
                part[i] -= v0 * r0[i] + v1 * r1[i] + v2 * r2[i] + v3 * r3[i]
        for j in range(whole, count):
            row, value = chunk[j, low:high], own[j]
            for i in range(len(part)):
                part[i] -= value * row[i]


@compiled(nogil=True, fastmath={"contract"})
def _rotate(row: Array, gone: Array, cosines: Array, sines: Array) -> None:
    """Turn what stood in removed columns into one row behind them (compiled).

    Args:
        row: The row's columns behind the removed ones, up to its diagonal.
        gone: Its entries in the removed columns, shape (m,).
        cosines: Rotations of the rows before, shape (·, m); gets this row's.
        sines: As ``cosines``.
    """
    m, last = len(gone), len(row) - 1
    for q in range(last):
        value = row[q]
        c, s = cosines[q], sines[q]
        for a in range(m):
            w = gone[a]
            gone[a] = c[a] * w - s[a] * value
            value = c[a] * value + s[a] * w
        row[q] = value
    value = row[last]
    for a in range(m):
        norm = math.sqrt(value * value + gone[a] * gone[a])
        cosines[last, a] = value / norm
        sines[last, a] = gone[a] / norm
        value = norm
    row[last] = value
