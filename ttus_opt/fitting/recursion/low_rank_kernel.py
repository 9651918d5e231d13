"""A low-rank factor of K, the kernel of the measured rows, with updates and downdates.

Measurements at one place are nearly dependent, and K has far fewer large eigenvalues
than rows. A few rows are chosen as pivots; every other column of K is a linear
combination of theirs, up to an error far below the measurement noise. So K ≈ R Rᵀ with
R of n rows and k columns. Its rows at the pivots are the Cholesky factor C of their
block of K; its other rows are the columns of N, C⁻¹ times their entries of K with the
pivots. Then

    (I + R Rᵀ)⁻¹ = I - R M⁻¹Rᵀ,    M = I + RᵀR = I + CᵀC + N Nᵀ = E Eᵀ.

This is the Nyström approximation in its stable form (Foster et al., "Stable and
efficient Gaussian process calculations", J. Mach. Learn. Res. 10 (2009) 857-882).

Rows may be added and removed any number of times without loss of accuracy:

- C is built only from entries of K that were solved for, never from entries of R Rᵀ,
  whose error C⁻¹ has amplified and would amplify again.
- A pivot is removed by Givens rotations of the columns, which leave all other products
  unchanged and one column to drop. The squares of its entries are added to the rows'
  residual variances. `LowRankKernel.remove` returns the rows that must replace the
  lost ones; the caller solves for their columns of K again.
- E is downdated (Golub, Van Loan, Matrix Computations, 4th ed., section 6.5.4), and
  recomputed after as many removals as there are rows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.recursion import packed_triangle as triangle
from ttus_opt.fitting.recursion.pivots import incomplete_cholesky, replacements

#: Least growth of the packed factors, and of the rows and columns of N [entries]
ROOM, MORE = 2**12, 8


@dataclass(frozen=True)
class Projection:
    """New rows projected on the columns of R.

    Attributes:
        held: Coordinates in the k present columns, shape (m, k).
        new: Coordinates in p new columns, shape (m, p).
        chosen: Pivots of the new columns among the rows, shape (p,).
        residual: Variance of each row outside all columns, shape (m,).
        schur: Schur complement of I + K, shape (m, m).
        gain: M⁻¹ times ``held`` transposed, shape (k, m).
    """

    held: Array
    new: Array
    chosen: IntArray
    residual: Array
    schur: Array
    gain: Array

    @property
    def rows(self) -> Array:
        """The rows to add to R, shape (m, k + p)."""
        return np.hstack([self.held, self.new])


class LowRankKernel:
    """R and E of the rows held.

    Attributes:
        pivots: Rows with a column of their own, in the columns' order, shape (k,).
        others: The other rows, in the order of N's columns, shape (n - k,).
    """

    def __init__(self) -> None:
        self._C: Array = np.zeros(ROOM)
        self._E: Array = np.zeros(ROOM)
        self._N: Array = np.zeros((MORE, MORE))
        # residual variance of the others
        self._residual = np.zeros(0)
        self.pivots = np.zeros(0, dtype=np.int64)
        self.others = np.zeros(0, dtype=np.int64)
        # number of downdates since E was computed
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
        """Size of all arrays, unused space included."""
        arrays = (self._C, self._E, self._N, self._residual, self.pivots, self.others)
        return sum(a.nbytes for a in arrays)

    def coordinates(self, cross: Array) -> Array:
        """Coordinates of rows in the columns held, shape (m, k); O(k²) per row.

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

    def project(self, held: Array, own: Array, tolerance: float) -> Projection:
        """Project new rows on the columns held; O(k²) per row.

        Args:
            held: Their `coordinates`, shape (m, k).
            own: Their own block of K, shape (m, m).
            tolerance: Residual variance below which a row needs no column of its own;
                well above the error of K's entries.

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
        new, chosen, left = incomplete_cholesky(beyond, tolerance)
        return Projection(held, new, chosen, left, schur, whitened.T)

    def append(
        self, projection: Projection, columns: Array, numbers: IntArray | None = None
    ) -> None:
        """Add projected rows; O(k²) per row, O(n k) per new column.

        Args:
            projection: Made by `project` since the last change.
            columns: Entries of K of the rows chosen with the others held, shape
                (p, n - k).
            numbers: Which rows they are, shape (m,); by default the next.

        Raises:
            InputError: Shapes that do not fit.
        """
        k, o, chosen = self.rank, len(self.others), projection.chosen
        m, p = projection.new.shape
        if columns.shape != (p, o):
            raise InputError(f"columns must be ({p}, {o}), got {columns.shape}")
        if numbers is None:
            numbers = np.arange(len(self), len(self) + m)
        rest = np.setdiff1d(np.arange(m), chosen)
        self._resize(k + p, o + len(rest))
        if p:
            self._N[k : k + p, :o] = self._new_columns(projection, columns)
        for j, a in enumerate(chosen):
            self._extend_factor(k + j, o)
            start = triangle.packed_size(k + j)
            self._C[start : start + k] = projection.held[a]
            self._C[start + k : start + k + j + 1] = projection.new[a, : j + 1]
        rows = projection.rows
        self._N[: k + p, o : o + len(rest)] = rows[rest].T
        triangle.update(self._E, np.ascontiguousarray(rows.T))
        self.pivots = np.concatenate([self.pivots, numbers[chosen]])
        self.others = np.concatenate([self.others, numbers[rest]])
        self._residual = np.concatenate([self._residual, projection.residual[rest]])

    def times(self, x: Array) -> Array:
        """R x, shape (n,).

        Args:
            x: One number per column, shape (k,).
        """
        out, part = np.empty(len(self)), np.empty(self.rank)
        triangle.times(self._C, x, part)
        out[self.pivots] = part
        out[self.others] = x @ self._coefficients
        return out

    def adjoint(self, y: Array) -> Array:
        """Rᵀ y, shape (k,).

        Args:
            y: One number per row, shape (n,).
        """
        out = np.asarray(self._coefficients @ y[self.others], np.float64)
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
        """Remove rows start to start + count.

        Costs O(k²) per row, O(n k) more for each that was a pivot.

        Args:
            start: First row.
            count: Number of rows.
            tolerance: As in `project`.

        Returns:
            New numbers of the rows that replace the pivots: `drop` them and `append`
            them again with newly solved entries of K, or their residual variance stays
            large.

        Raises:
            InputError: Rows that do not exist.
        """
        n = len(self)
        if start < 0 or count < 0 or start + count > n:
            raise InputError(f"rows {start} to {start + count} are not within 0 to {n}")
        going = (self.pivots >= start) & (self.pivots < start + count)
        places = np.flatnonzero(going)[::-1]
        self._resize(self.rank, len(self.others) + len(places))
        losses = [self._demote_pivot(int(q)) for q in places]
        lost = np.zeros((len(losses), len(self.others)))
        for row, loss in zip(lost, losses, strict=True):
            row[: len(loss)] = loss
        kept = self._drop((self.others >= start) & (self.others < start + count))
        self.pivots = np.where(
            self.pivots >= start, self.pivots - count, self.pivots
        ).astype(np.int64)
        self.others = np.where(
            self.others >= start, self.others - count, self.others
        ).astype(np.int64)
        return self.others[
            replacements(lost[:, kept], self._residual, self.others, tolerance)
        ]

    def drop(self, rows: IntArray) -> None:
        """Remove rows that are not pivots, to `append` them again; O(k²) per row.

        Args:
            rows: Their numbers, which stay reserved.

        Raises:
            InputError: One of them is a pivot or does not exist.
        """
        mask = np.isin(self.others, rows)
        if np.count_nonzero(mask) != len(rows):
            raise InputError("only held rows that are not pivots can be dropped")
        self._drop(mask)

    def scale(self, factor: float) -> None:
        """Multiply R by a number; O(n k²)."""
        self._C *= factor
        self._N *= factor
        self._residual *= factor**2
        self._refresh()

    @property
    def _coefficients(self) -> Array:
        """N, shape (k, n - k)."""
        return self._N[: self.rank, : len(self.others)]

    def _new_columns(self, projection: Projection, columns: Array) -> Array:
        """The others' entries in new columns, shape (p, n - k)."""
        chosen = projection.chosen
        corner = projection.new[chosen]
        out = columns - projection.held[chosen] @ self._coefficients
        for j, row in enumerate(out):
            row -= corner[j, :j] @ out[:j]
            row /= corner[j, j]
            # up to rounding, an entry is at most the root of the residual variance
            most = np.sqrt(self._residual)
            np.clip(row, -most, most, out=row)
            self._residual = np.maximum(self._residual - row**2, 0.0)
        return out

    def _extend_factor(self, k: int, o: int) -> None:
        """Add row k to E, from the entries of the others in column k."""
        column = self._N[k, :o]
        row = np.asarray(self._N[:k, :o] @ column, np.float64)[None]
        triangle.forward(self._E, row)
        start = triangle.packed_size(k)
        self._E[start : start + k] = row[0]
        own = 1.0 + column @ column - row[0] @ row[0]
        # M ≥ I, and so is each of its Schur complements
        self._E[start + k] = math.sqrt(max(own, 1.0))

    def _demote_pivot(self, q: int) -> Array:
        """Make pivot q one of the others; the column dropped, shape (n - k,)."""
        k, o = self.rank, len(self.others)
        start = triangle.packed_size(q)
        self._N[: q + 1, o] = self._C[start : start + q + 1]
        self._N[q + 1 : k, o] = 0.0
        cosines, sines = np.empty(k), np.empty(k)
        triangle.delete_row(self._C, k, q, cosines, sines)
        triangle.rotate_rows(self._N[:, : o + 1], k, q, cosines, sines)
        triangle.rotate_factor(self._E, k, q, cosines, sines)
        loss = self._N[k - 1, : o + 1].copy()
        self._residual = np.append(self._residual, 0.0) + loss**2
        self.others = np.append(self.others, self.pivots[q])
        self.pivots = np.delete(self.pivots, q)
        return loss

    def _drop(self, mask: NDArray[np.bool_]) -> IntArray:
        """Drop others; return the former places of the remaining ones."""
        o, k = len(self.others), self.rank
        gone = np.flatnonzero(mask)
        sound = triangle.downdate(self._E, np.ascontiguousarray(self._N[:k, gone].T))
        left = o - len(gone)
        # the last ones move into the gaps
        kept = np.arange(left)
        holes = gone[gone < left]
        kept[holes] = left + np.flatnonzero(~mask[left:])
        self._N[:k, holes] = self._N[:k, kept[holes]]
        self.others, self._residual = self.others[kept], self._residual[kept]
        self._downdated += len(gone)
        if not sound or self._downdated >= len(self):
            self._refresh()
        self._resize(k, left)
        return kept

    def _refresh(self) -> None:
        """Compute E from C and N; O(n k²)."""
        k = self.rank
        C = triangle.unpacked(self._C, k)
        M = np.eye(k) + C.T @ C + self._coefficients @ self._coefficients.T
        factor = np.asarray(np.linalg.cholesky(M), np.float64)
        self._E[: triangle.packed_size(k)] = triangle.packed(factor)
        self._downdated = 0

    def _resize(self, k: int, o: int) -> None:
        """Allocate for k pivots and o others, with space to grow."""
        size = triangle.packed_size(k)
        self._C, self._E = _fitted(self._C, size), _fitted(self._E, size)
        rows, columns = self._N.shape
        if k <= rows <= 2 * (k + MORE) and o <= columns <= 2 * (o + MORE):
            return
        grown = np.zeros((k + k // 16 + MORE, o + o // 16 + MORE))
        rows, columns = min(rows, len(grown)), min(columns, grown.shape[1])
        grown[:rows, :columns] = self._N[:rows, :columns]
        self._N = grown


def _fitted(values: Array, size: int) -> Array:
    """The array resized where needed; large arrays are moved, not copied."""
    if not size <= len(values) <= 2 * size + ROOM:
        values.resize(size + size // 16 + ROOM, refcheck=False)
    return values
