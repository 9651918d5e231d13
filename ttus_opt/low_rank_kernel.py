"""I + K of measured rows whose K has far fewer large eigenvalues than rows.

Measurements of one spot say nearly the same: beyond its first rows, a row's column of
K is a combination of those of earlier ones, up to what no measurement can tell from
its noise. So K ≈ R Rᵀ with R of n rows and k columns, an incomplete Cholesky factor
that takes its pivots in the order of arrival: a row brings a column of its own only
if its part outside the span of the earlier pivots has a variance above a tolerance.
R is a staircase, its pivot rows are the Cholesky factor C of their block of K, and

    (I + R Rᵀ)⁻¹ = I - R M⁻¹Rᵀ,    M = I + RᵀR = E Eᵀ.

Rows whose K has no structure at all make it the ordinary Cholesky factor, and E as
large as that: n² numbers at the most.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ttus_opt.compiled import compiled
from ttus_opt.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: By how many numbers memory grows at a time, at least
ROOM = 2**12

#: What a pivot's variance is raised by, over the tolerance: rows may nearly depend on
#: each other, and C must stay far enough from singular for the error of its entries
JITTER = 0.1

#: A row that leaves less than this of what is known of it takes too many digits along
LEAST_LEFT = 1e-6

#: Rows of R that are dense at a time while M is made anew
PIECE = 512


@dataclass(frozen=True)
class Outlook:
    """New rows seen from those held.

    Attributes:
        rows: What they add to R, shape (m, k + p) with p new columns.
        widths: Columns that each row uses, shape (m,).
        schur: Schur complement of I + K, shape (m, m).
        gain: M⁻¹ times the rows' part in the k columns held, shape (k, m).
    """

    rows: Array
    widths: Index
    schur: Array
    gain: Array


class LowRankKernel:
    """R and E of the rows so far.

    Attributes:
        pivots: Rows that brought a column, increasing, shape (k,).
    """

    def __init__(self) -> None:
        self._widths = np.zeros(0, dtype=np.int64)
        self._starts = np.zeros(1, dtype=np.int64)
        # rows of R and of E, one after the other
        self._R: Array = np.zeros(ROOM)
        self._E: Array = np.zeros(ROOM)
        self.pivots = np.zeros(0, dtype=np.int64)

    def __len__(self) -> int:
        """Number of rows n [–]."""
        return len(self._widths)

    @property
    def rank(self) -> int:
        """Number of columns k [–]."""
        return len(self.pivots)

    @property
    def memory_bytes(self) -> int:
        """Size of all arrays, room to grow included."""
        arrays = (self._R, self._E, self._widths, self._starts, self.pivots)
        return sum(a.nbytes for a in arrays)

    def outlook(self, cross: Array, own: Array, tolerance: float) -> Outlook:
        """See new rows from those held; O(k²) per row.

        Args:
            cross: Their entries of K with the pivots, shape (m, k).
            own: Their own block of K, shape (m, m).
            tolerance: Variance beyond the span of the pivots that is none; well above
                the error of ``cross`` and ``own``.

        Raises:
            InputError: Shapes that do not fit.
        """
        m, k = len(own), self.rank
        if cross.shape != (m, k) or own.shape != (m, m):
            raise InputError(
                f"new rows must be ({m}, {k}) with a corner ({m}, {m}), got "
                f"{cross.shape} and {own.shape}"
            )
        held = np.array(cross, order="C")
        _reduce(self._R, self._starts, self.pivots, held)
        # einsum: too little work to wake a threaded BLAS for
        beyond = own - np.einsum("ik,jk->ij", held, held)
        whitened = held.copy()
        _forward(self._E, whitened)
        schur = np.eye(m) + beyond + np.einsum("ik,jk->ij", whitened, whitened)
        for row in whitened:
            _backward(self._E, row)
        new, widths = _staircase(beyond, tolerance)
        rows = np.hstack([held, new])
        return Outlook(rows, k + widths, schur, whitened.T)

    def append(self, outlook: Outlook) -> None:
        """Take the rows of an outlook in; O(k²) per row.

        Args:
            outlook: Made by `outlook` since the last change.
        """
        n, k = len(self), self.rank
        ends = self._starts[-1] + np.cumsum(outlook.widths)
        self._R = _fitted(self._R, int(ends[-1]))
        for row, width, end in zip(outlook.rows, outlook.widths, ends, strict=True):
            self._R[end - width : end] = row[:width]
        before = np.concatenate([[k], outlook.widths[:-1]])
        new = np.flatnonzero(outlook.widths > before)
        self.pivots = np.concatenate([self.pivots, n + new])
        self._widths = np.concatenate([self._widths, outlook.widths])
        self._starts = np.concatenate([self._starts, ends])
        rank = self.rank
        self._E = _fitted(self._E, rank * (rank + 1) // 2)
        for j in range(k, rank):
            self._E[j * (j + 1) // 2 : (j + 1) * (j + 2) // 2 - 1] = 0.0
            self._E[(j + 1) * (j + 2) // 2 - 1] = 1.0
        _update(self._E, np.ascontiguousarray(outlook.rows.T))

    def times(self, x: Array) -> Array:
        """R x, shape (n,).

        Args:
            x: One number per column, shape (k,).
        """
        out = np.empty(len(self))
        _times(self._R, self._starts, x, out)
        return out

    def adjoint(self, y: Array) -> Array:
        """Rᵀ y, shape (k,).

        Args:
            y: One number per row, shape (n,).
        """
        out = np.zeros(self.rank)
        _adjoint(self._R, self._starts, y, out)
        return out

    def solve(self, right_side: Array) -> Array:
        """Solve (I + R Rᵀ) y = g.

        Args:
            right_side: g, shape (n,).

        Returns:
            y, shape (n,).

        Raises:
            InputError: Another length than n.
        """
        if right_side.shape != (len(self),):
            raise InputError(
                f"a right side must have shape ({len(self)},), got {right_side.shape}"
            )
        part = self.adjoint(right_side)[None]
        _forward(self._E, part)
        _backward(self._E, part[0])
        return right_side - self.times(part[0])

    def remove(self, start: int, count: int, tolerance: float) -> None:
        """Take rows start to start + count out.

        Where pivots go, later rows take over, and columns of R are turned so that it
        is a staircase again. Costs O(n + k²) per row, O(n k) more for a row that was
        a pivot, where no other row comes soon that takes its place.

        Args:
            start: First row.
            count: Number of rows.
            tolerance: As in `outlook`.

        Raises:
            InputError: Rows that are not there.
        """
        n = len(self)
        if start < 0 or count < 0 or start + count > n:
            raise InputError(f"rows {start} to {start + count} are not within 0 to {n}")
        gone = self._dense(start, start + count)
        low, high = self._starts[start], self._starts[start + count]
        used = int(self._starts[-1])
        self._R[low : used - (high - low)] = self._R[high:used].copy()
        widths = np.delete(self._widths, slice(start, start + count))
        starts = np.concatenate([[0], np.cumsum(widths)])
        sound = _downdate(self._E, gone)
        self.pivots = _restored(self._R, self._E, starts, widths, tolerance)
        _compact(self._R, starts, widths)
        self._widths, self._starts = widths, np.concatenate([[0], np.cumsum(widths)])
        self._R = _fitted(self._R, int(self._starts[-1]))
        self._E = _fitted(self._E, self.rank * (self.rank + 1) // 2)
        if not sound:
            self._refresh()

    def scale(self, factor: float) -> None:
        """Multiply R by a number."""
        self._R[: self._starts[-1]] *= factor
        self._refresh()

    def dense(self) -> Array:
        """R with zeros where it has no entries, shape (n, k)."""
        return self._dense(0, len(self))

    def _dense(self, first: int, last: int) -> Array:
        out = np.zeros((last - first, self.rank))
        for i in range(first, last):
            row = self._R[self._starts[i] : self._starts[i + 1]]
            out[i - first, : len(row)] = row
        return out

    def _refresh(self) -> None:
        """Make E anew; O(n k²)."""
        k = self.rank
        M = np.eye(k)
        for first in range(0, len(self), PIECE):
            piece = self._dense(first, min(first + PIECE, len(self)))
            M += piece.T @ piece
        self._E = np.asarray(np.linalg.cholesky(M)[np.tril_indices(k)], np.float64)


def _staircase(beyond: Array, tolerance: float) -> tuple[Array, Index]:
    """Incomplete Cholesky factor of a small matrix, and the widths of its rows."""
    m = len(beyond)
    rows, widths, k = np.zeros((m, m)), np.zeros(m, dtype=np.int64), 0
    pivots: list[int] = []
    for a in range(m):
        for j, p in enumerate(pivots):
            rows[a, j] = (beyond[a, p] - rows[a, :j] @ rows[p, :j]) / rows[p, j]
        left = beyond[a, a] - rows[a, :k] @ rows[a, :k]
        if left > tolerance:
            rows[a, k] = math.sqrt(left + JITTER * tolerance)
            pivots.append(a)
            k += 1
        widths[a] = k
    return rows[:, :k], widths


def _fitted(values: Array, size: int) -> Array:
    """The same memory, or more or less of it; large arrays are moved, not copied."""
    if not size <= len(values) <= 2 * size + ROOM:
        values.resize(size + size // 16 + ROOM, refcheck=False)
    return values


@compiled(nogil=True, fastmath={"reassoc", "contract"})
def _dot(a: Array, b: Array) -> float:
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@compiled(nogil=True, fastmath={"reassoc", "contract"})
def _take(a: Array, value: float, b: Array) -> None:
    for i in range(len(b)):
        a[i] -= value * b[i]


@compiled(nogil=True)
def _reduce(R: Array, starts: Index, pivots: Index, x: Array) -> None:
    """Solve C x = g for the rows of x, in place (compiled)."""
    for j in range(len(pivots)):
        start = starts[pivots[j]]
        row = R[start : start + j]
        for c in range(len(x)):
            x[c, j] = (x[c, j] - _dot(row, x[c, :j])) / R[start + j]


@compiled(nogil=True)
def _times(R: Array, starts: Index, x: Array, out: Array) -> None:
    """R x (compiled)."""
    for i in range(len(out)):
        row = R[starts[i] : starts[i + 1]]
        out[i] = _dot(row, x[: len(row)])


@compiled(nogil=True)
def _adjoint(R: Array, starts: Index, y: Array, out: Array) -> None:
    """Add Rᵀ y to out (compiled)."""
    for i in range(len(y)):
        _take(out, -y[i], R[starts[i] : starts[i + 1]])


@compiled(nogil=True)
def _forward(E: Array, x: Array) -> None:
    """Solve E x = g for the rows of x, in place (compiled)."""
    start = 0
    for j in range(x.shape[1]):
        row = E[start : start + j]
        for c in range(len(x)):
            x[c, j] = (x[c, j] - _dot(row, x[c, :j])) / E[start + j]
        start += j + 1


@compiled(nogil=True)
def _backward(E: Array, y: Array) -> None:
    """Solve Eᵀ y = z, in place (compiled)."""
    for j in range(len(y) - 1, -1, -1):
        start = j * (j + 1) // 2
        y[j] /= E[start + j]
        _take(y, y[j], E[start : start + j])


@compiled(nogil=True, fastmath={"contract"})
def _update(E: Array, added: Array) -> None:
    """Make E the factor of E Eᵀ + W Wᵀ by Givens rotations, in place (compiled).

    Args:
        E: Rows of the factor, one after the other.
        added: W, overwritten, shape (k, m).
    """
    k, m = added.shape
    cosines, sines = np.empty((k, m)), np.empty((k, m))
    for j in range(k):
        start, rest = j * (j + 1) // 2, added[j]
        for q in range(j):
            value, c, s = E[start + q], cosines[q], sines[q]
            for a in range(m):
                w = rest[a]
                rest[a] = c[a] * w - s[a] * value
                value = c[a] * value + s[a] * w
            E[start + q] = value
        value = E[start + j]
        for a in range(m):
            norm = math.sqrt(value * value + rest[a] * rest[a])
            cosines[j, a], sines[j, a] = value / norm, rest[a] / norm
            value = norm
        E[start + j] = value


@compiled(nogil=True, fastmath={"contract"})
def _restored(
    R: Array, E: Array, starts: Index, widths: Index, tolerance: float
) -> Index:
    """Turn columns of R until it is a staircase again, in place (compiled).

    Args:
        R: Rows, one after the other.
        E: Its factor of I + RᵀR, turned with it.
        starts: Where they start.
        widths: Columns of each, never less than those of the row before; set to how
            many it keeps.
        tolerance: See `LowRankKernel.remove`.

    Returns:
        The pivots.
    """
    pivots = np.empty(len(widths), dtype=np.int64)
    k, last = 0, widths[-1] if len(widths) else 0
    for i in range(len(widths)):
        if widths[i] <= k:
            continue
        # what is beyond the columns so far is turned into the first one there
        for q in range(widths[i] - 2, k - 1, -1):
            at = starts[i] + q
            norm = math.hypot(R[at], R[at + 1])
            if norm > 0.0:
                c, s = R[at] / norm, R[at + 1] / norm
                for j in range(i, len(widths)):
                    at = starts[j] + q
                    R[at], R[at + 1] = (
                        c * R[at] + s * R[at + 1],
                        c * R[at + 1] - s * R[at],
                    )
                _turn(E, q, c, s, last)
        if R[starts[i] + k] ** 2 > tolerance:
            pivots[k] = i
            k += 1
        widths[i] = k
    return pivots[:k].copy()


@compiled(nogil=True)
def _turn(E: Array, q: int, c: float, s: float, k: int) -> None:
    """Turn rows q and q + 1 of E, and columns until it is triangular (compiled).

    Args:
        E: Rows of the factor, one after the other.
        q: Number of the row.
        c: Cosine.
        s: Sine.
        k: Rows of E that are of use.
    """
    top, low = q * (q + 1) // 2, (q + 1) * (q + 2) // 2
    for i in range(q + 1):
        a, b = E[top + i], E[low + i]
        E[top + i], E[low + i] = c * a + s * b, c * b - s * a
    # row q has got an entry beyond its diagonal
    beyond, E[low + q + 1] = s * E[low + q + 1], c * E[low + q + 1]
    norm = math.hypot(E[top + q], beyond)
    c, s = E[top + q] / norm, beyond / norm
    E[top + q] = norm
    for i in range(q + 1, k):
        at = i * (i + 1) // 2 + q
        E[at], E[at + 1] = c * E[at] + s * E[at + 1], c * E[at + 1] - s * E[at]
    if E[low + q + 1] < 0.0:
        for i in range(q + 1, k):
            E[i * (i + 1) // 2 + q + 1] *= -1.0


@compiled(nogil=True, fastmath={"contract"})
def _downdate(E: Array, gone: Array) -> bool:
    """Make E the factor of E Eᵀ - Σ w wᵀ, row w after row, in place (compiled).

    Args:
        E: Rows of the factor, one after the other.
        gone: Rows w, overwritten, shape (m, k).

    Returns:
        Whether enough digits are left; E is spoilt if not.
    """
    m, k = gone.shape
    cosines, sines = np.empty(k), np.empty(k)
    for a in range(m):
        w = gone[a : a + 1]
        _forward(E, w)
        left = 1.0 - _dot(w[0], w[0])
        if left < LEAST_LEFT:
            return False
        left = math.sqrt(left)
        # rotations that turn (w, left) into (0, 1), from the last entry on
        for j in range(k - 1, -1, -1):
            norm = math.hypot(left, w[0, j])
            cosines[j], sines[j] = left / norm, w[0, j] / norm
            left = norm
        for i in range(k):
            start, rest = i * (i + 1) // 2, 0.0
            for j in range(i, -1, -1):
                value = E[start + j]
                E[start + j] = cosines[j] * value - sines[j] * rest
                rest = cosines[j] * rest + sines[j] * value
    return True


@compiled(nogil=True)
def _compact(R: Array, starts: Index, widths: Index) -> None:
    """Close the gaps behind rows that keep fewer columns, in place (compiled)."""
    end = 0
    for i in range(len(widths)):
        for q in range(widths[i]):
            R[end + q] = R[starts[i] + q]
        end += widths[i]
