"""I + K of measured rows whose K has far fewer large eigenvalues than rows.

Measurements of one spot say nearly the same: beyond a few rows, the pivots, a row's
column of K is a combination of theirs, up to what no measurement can tell from its
noise. So K ≈ R Rᵀ with R of n rows and k columns. Its rows at the pivots are the
Cholesky factor C of their block of K, those of the others, as the columns of N, are
what C makes of their entries with the pivots, and

    (I + R Rᵀ)⁻¹ = I - R M⁻¹Rᵀ,    M = I + RᵀR = I + CᵀC + N Nᵀ = E Eᵀ.

This is the Nyström approximation in its stable form (Foster et al., "Stable and
efficient Gaussian process calculations", J. Mach. Learn. Res. 10 (2009) 857-882).

Rows may come and go without end. Entries of R are never taken for entries of K: what
R makes of two rows that are no pivots carries an error that C⁻¹ has enlarged, and
enlarges it once more when it comes to stand in C itself. So C is only ever made of
entries of K as they were solved for. A pivot goes by rotations of the columns, which
leave all other products as they are and one column to be dropped; what that column
said of a row is added to the variance that R leaves out of it, and rows that stand
for what is lost are named by `LowRankKernel.remove`, to be compared anew with all
others. E is downdated, and made anew once as many rows went as there are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ttus_opt.arrays import Array, IntArray
from ttus_opt.errors import InputError
from ttus_opt.fit import packed_triangle as triangle

#: By how many numbers memory grows at a time, at least, and rows and columns of N
ROOM, MORE = 2**12, 8

#: What a pivot's variance is raised by, over the tolerance: rows may nearly depend on
#: each other, and C must stay far enough from singular for the error of its entries
JITTER = 0.1

#: A row stands for what is lost if it has this part of the largest loss: the newest
#: of them is taken, for it will stay longest
SHARE = 0.25


@dataclass(frozen=True)
class Outlook:
    """New rows seen from those held.

    Attributes:
        held: Their part in the k columns held, shape (m, k).
        new: What they add in p new columns, shape (m, p).
        chosen: Which of them are the pivots of the new columns, shape (p,).
        left: Variance that is left out of each, shape (m,).
        schur: Schur complement of I + K, shape (m, m).
        gain: M⁻¹ times the rows' part in the k columns held, shape (k, m).
    """

    held: Array
    new: Array
    chosen: IntArray
    left: Array
    schur: Array
    gain: Array

    @property
    def rows(self) -> Array:
        """What they add to R, shape (m, k + p)."""
        return np.hstack([self.held, self.new])


class LowRankKernel:
    """R and E of the rows held.

    Attributes:
        pivots: Rows that have a column of their own, in its order, shape (k,).
        others: The other rows, in the order of N's columns, shape (n - k,).
    """

    def __init__(self) -> None:
        self._C: Array = np.zeros(ROOM)
        self._E: Array = np.zeros(ROOM)
        self._N: Array = np.zeros((MORE, MORE))
        # variance of the others that R leaves out
        self._left = np.zeros(0)
        self.pivots = np.zeros(0, dtype=np.int64)
        self.others = np.zeros(0, dtype=np.int64)
        # rows that E was downdated by since it was made
        self._downdated = 0

    def __len__(self) -> int:
        """Number of rows n [–]."""
        return len(self.pivots) + len(self.others)

    @property
    def rank(self) -> int:
        """Number of columns k [–]."""
        return len(self.pivots)

    @property
    def memory_bytes(self) -> int:
        """Size of all arrays, room to grow included."""
        arrays = (self._C, self._E, self._N, self._left, self.pivots, self.others)
        return sum(a.nbytes for a in arrays)

    @property
    def largest_left(self) -> float:
        """Largest variance of a row that R leaves out."""
        return float(self._left.max(initial=0.0))

    def coordinates(self, cross: Array) -> Array:
        """Rows' part in the columns held, shape (m, k); O(k²) per row.

        Args:
            cross: Their entries of K with the pivots, shape (m, k).

        Raises:
            InputError: Another number of columns.
        """
        if cross.ndim != 2 or cross.shape[1] != self.rank:
            raise InputError(
                f"new rows must be (m, {self.rank}), one entry for each pivot, got "
                f"{cross.shape}"
            )
        held = np.array(cross, order="C")
        triangle.forward(self._C, held)
        return held

    def outlook(self, held: Array, own: Array, tolerance: float) -> Outlook:
        """See new rows from those held; O(k²) per row.

        Args:
            held: Their `coordinates`, shape (m, k).
            own: Their own block of K, shape (m, m).
            tolerance: Variance beyond the span of the pivots that is none; well above
                the error of K's entries.

        Raises:
            InputError: Shapes that do not fit.
        """
        m, k = len(own), self.rank
        if held.shape != (m, k) or own.shape != (m, m):
            raise InputError(
                f"new rows must be ({m}, {k}) with a corner ({m}, {m}), got "
                f"{held.shape} and {own.shape}"
            )
        # einsum: too little work to wake a threaded BLAS for
        beyond = own - np.einsum("ik,jk->ij", held, held)
        whitened = held.copy()
        triangle.forward(self._E, whitened)
        schur = np.eye(m) + beyond + np.einsum("ik,jk->ij", whitened, whitened)
        for row in whitened:
            triangle.backward(self._E, row)
        new, chosen, left = _incomplete_cholesky(beyond, tolerance)
        return Outlook(held, new, chosen, left, schur, whitened.T)

    def append(
        self, outlook: Outlook, columns: Array, numbers: IntArray | None = None
    ) -> None:
        """Take the rows of an outlook in; O(k²) per row, O(n k) per new column.

        Args:
            outlook: Made by `outlook` since the last change.
            columns: Entries of K of the rows chosen with the others held, shape
                (p, n - k).
            numbers: Which rows they are, shape (m,); by default the next.

        Raises:
            InputError: Shapes that do not fit.
        """
        k, o, chosen = self.rank, len(self.others), outlook.chosen
        m, p = outlook.new.shape
        if columns.shape != (p, o):
            raise InputError(f"columns must be ({p}, {o}), got {columns.shape}")
        if numbers is None:
            numbers = np.arange(len(self), len(self) + m)
        rest = np.setdiff1d(np.arange(m), chosen)
        self._resize(k + p, o + len(rest))
        if p:
            self._N[k : k + p, :o] = self._new_columns(outlook, columns)
        for j, a in enumerate(chosen):
            self._extend_factor(k + j, o)
            start = triangle.packed_size(k + j)
            self._C[start : start + k] = outlook.held[a]
            self._C[start + k : start + k + j + 1] = outlook.new[a, : j + 1]
        rows = outlook.rows
        self._N[: k + p, o : o + len(rest)] = rows[rest].T
        triangle.update(self._E, np.ascontiguousarray(rows.T))
        self.pivots = np.concatenate([self.pivots, numbers[chosen]])
        self.others = np.concatenate([self.others, numbers[rest]])
        self._left = np.concatenate([self._left, outlook.left[rest]])

    def times(self, x: Array) -> Array:
        """R x, shape (n,).

        Args:
            x: One number per column, shape (k,).
        """
        out, part = np.empty(len(self)), np.empty(self.rank)
        triangle.times(self._C, x, part)
        out[self.pivots] = part
        out[self.others] = x @ self._leaning
        return out

    def adjoint(self, y: Array) -> Array:
        """Rᵀ y, shape (k,).

        Args:
            y: One number per row, shape (n,).
        """
        out = np.asarray(self._leaning @ y[self.others], np.float64)
        triangle.add_adjoint(self._C, y[self.pivots], out)
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
        triangle.forward(self._E, part)
        triangle.backward(self._E, part[0])
        return right_side - self.times(part[0])

    def remove(self, start: int, count: int, tolerance: float) -> IntArray:
        """Take rows start to start + count out.

        Costs O(k²) per row, O(n k) more for each that was a pivot.

        Args:
            start: First row.
            count: Number of rows.
            tolerance: As in `outlook`.

        Returns:
            Rows that stand for what is lost with the pivots, by their numbers now:
            `take_out` and `append` them with entries of K solved for anew, or R
            leaves out what they say.

        Raises:
            InputError: Rows that are not there.
        """
        n = len(self)
        if start < 0 or count < 0 or start + count > n:
            raise InputError(f"rows {start} to {start + count} are not within 0 to {n}")
        going = (self.pivots >= start) & (self.pivots < start + count)
        places = np.flatnonzero(going)[::-1]
        self._resize(self.rank, len(self.others) + len(places))
        losses = [self._demote(int(q)) for q in places]
        lost = np.zeros((len(losses), len(self.others)))
        for row, loss in zip(lost, losses, strict=True):
            row[: len(loss)] = loss
        kept = self._take_out((self.others >= start) & (self.others < start + count))
        self.pivots = np.where(
            self.pivots >= start, self.pivots - count, self.pivots
        ).astype(np.int64)
        self.others = np.where(
            self.others >= start, self.others - count, self.others
        ).astype(np.int64)
        return self._standing_for(lost[:, kept], tolerance)

    def take_out(self, rows: IntArray) -> None:
        """Take rows out that are no pivots, to `append` them again; O(k²) per row.

        Args:
            rows: Their numbers, which nothing else takes meanwhile.

        Raises:
            InputError: One of them is a pivot, or not there.
        """
        mask = np.isin(self.others, rows)
        if np.count_nonzero(mask) != len(rows):
            raise InputError("only rows that are held and no pivots can be taken out")
        self._take_out(mask)

    def scale(self, factor: float) -> None:
        """Multiply R by a number; O(n k²)."""
        self._C *= factor
        self._N *= factor
        self._left *= factor**2
        self._refresh()

    def dense(self) -> Array:
        """R with all its zeros, shape (n, k)."""
        out = np.zeros((len(self), self.rank))
        out[self.pivots] = triangle.unpacked(self._C, self.rank)
        out[self.others] = self._leaning.T
        return out

    @property
    def _leaning(self) -> Array:
        """N, shape (k, n - k)."""
        return self._N[: self.rank, : len(self.others)]

    def _new_columns(self, outlook: Outlook, columns: Array) -> Array:
        """The others' entries in new columns, shape (p, n - k)."""
        chosen = outlook.chosen
        corner = outlook.new[chosen]
        out = columns - outlook.held[chosen] @ self._leaning
        for j, row in enumerate(out):
            row -= corner[j, :j] @ out[:j]
            row /= corner[j, j]
            # beyond rounding, no row has more there than is left out of it
            most = np.sqrt(self._left)
            np.clip(row, -most, most, out=row)
            self._left = np.maximum(self._left - row**2, 0.0)
        return out

    def _extend_factor(self, k: int, o: int) -> None:
        """Add a row to E for column k, of which the others held have entries."""
        column = self._N[k, :o]
        row = np.asarray(self._N[:k, :o] @ column, np.float64)[None]
        triangle.forward(self._E, row)
        start = triangle.packed_size(k)
        self._E[start : start + k] = row[0]
        own = 1.0 + column @ column - row[0] @ row[0]
        # M is I at the least, and so is each Schur complement of it
        self._E[start + k] = math.sqrt(max(own, 1.0))

    def _demote(self, q: int) -> Array:
        """Make pivot q one of the others; what they lose with it, shape (n - k,)."""
        k, o = self.rank, len(self.others)
        start = triangle.packed_size(q)
        self._N[: q + 1, o] = self._C[start : start + q + 1]
        self._N[q + 1 : k, o] = 0.0
        cosines, sines = np.empty(k), np.empty(k)
        triangle.delete_row(self._C, k, q, cosines, sines)
        triangle.rotate_rows(self._N[:, : o + 1], k, q, cosines, sines)
        triangle.rotate_factor(self._E, k, q, cosines, sines)
        loss = self._N[k - 1, : o + 1].copy()
        self._left = np.append(self._left, 0.0) + loss**2
        self.others = np.append(self.others, self.pivots[q])
        self.pivots = np.delete(self.pivots, q)
        return loss

    def _take_out(self, mask: NDArray[np.bool_]) -> IntArray:
        """Take others out, and the places before of those that stay."""
        o, k = len(self.others), self.rank
        gone = np.flatnonzero(mask)
        sound = triangle.downdate(self._E, np.ascontiguousarray(self._N[:k, gone].T))
        left = o - len(gone)
        # the last ones move to where there is room
        kept = np.arange(left)
        holes = gone[gone < left]
        kept[holes] = left + np.flatnonzero(~mask[left:])
        self._N[:k, holes] = self._N[:k, kept[holes]]
        self.others, self._left = self.others[kept], self._left[kept]
        self._downdated += len(gone)
        if not sound or self._downdated >= len(self):
            self._refresh()
        self._resize(k, left)
        return kept

    def _standing_for(self, lost: Array, tolerance: float) -> IntArray:
        """Rows by which what is lost is known again, by a pivoted Cholesky factor.

        Args:
            lost: Columns that were dropped, shape (g, n - k).
            tolerance: As in `outlook`.
        """
        chosen: list[int] = []
        for _ in range(len(lost)):
            size = np.where(self._left > tolerance, np.sum(lost**2, axis=0), 0.0)
            largest = float(size.max(initial=0.0))
            if largest <= tolerance:
                break
            enough = np.flatnonzero(size >= max(SHARE * largest, tolerance))
            best = int(enough[np.argmax(self.others[enough])])
            chosen.append(best)
            unit = lost[:, best] / math.sqrt(size[best])
            lost = lost - np.outer(unit, unit @ lost)
            lost[:, best] = 0.0
        return self.others[chosen]

    def _refresh(self) -> None:
        """Make E anew; O(n k²)."""
        k = self.rank
        C = triangle.unpacked(self._C, k)
        M = np.eye(k) + C.T @ C + self._leaning @ self._leaning.T
        factor = np.asarray(np.linalg.cholesky(M), np.float64)
        self._E[: triangle.packed_size(k)] = triangle.packed(factor)
        self._downdated = 0

    def _resize(self, k: int, o: int) -> None:
        """Room for k pivots and o others, neither too little nor far too much."""
        size = triangle.packed_size(k)
        self._C, self._E = _fitted(self._C, size), _fitted(self._E, size)
        rows, columns = self._N.shape
        if k <= rows <= 2 * (k + MORE) and o <= columns <= 2 * (o + MORE):
            return
        grown = np.zeros((k + k // 16 + MORE, o + o // 16 + MORE))
        rows, columns = min(rows, len(grown)), min(columns, grown.shape[1])
        grown[:rows, :columns] = self._N[:rows, :columns]
        self._N = grown


def _incomplete_cholesky(B: Array, tolerance: float) -> tuple[Array, IntArray, Array]:
    """Pivoted incomplete Cholesky factor of a small matrix.

    Returns:
        The factor, triangular in its pivots' rows, shape (m, p); the pivots, shape
        (p,); the variance that it leaves out, shape (m,).
    """
    rest, left = B.copy(), np.maximum(np.diag(B), 0.0)
    columns, chosen = [], np.zeros(0, dtype=np.int64)
    while len(chosen) < len(B):
        free = np.where(np.isin(np.arange(len(B)), chosen), 0.0, left)
        best = int(np.argmax(free))
        if not free[best] > tolerance:
            break
        most = np.sqrt(free)
        size = math.sqrt(free[best] + JITTER * tolerance)
        column = np.clip(rest[:, best] / size, -most, most)
        column[best] = size
        rest -= np.outer(column, column)
        left = np.maximum(left - column**2, 0.0)
        columns.append(column)
        chosen = np.append(chosen, best)
    return np.array(columns).reshape(len(columns), len(B)).T, chosen, left


def _fitted(values: Array, size: int) -> Array:
    """The same memory, or more or less of it; large arrays are moved, not copied."""
    if not size <= len(values) <= 2 * size + ROOM:
        values.resize(size + size // 16 + ROOM, refcheck=False)
    return values
