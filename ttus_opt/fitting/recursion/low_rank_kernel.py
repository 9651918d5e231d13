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
- What is removed is subtracted from M = E Eᵀ, and M recomputed from C and N after as
  many removals as there are rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.fitting.recursion import triangular_factor
from ttus_opt.fitting.recursion.triangular_factor import (
    incomplete_cholesky,
    replacements,
)

#: Least growth of the rows and columns of N [–]
MORE = 8

#: Fall of M's trace above which subtractions have lost too many digits [–]
LARGEST_FALL = 1e6


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
        self._C: Array = np.zeros((0, 0))
        self._E: Array = np.zeros((0, 0))
        self._N: Array = np.zeros((MORE, MORE))
        # residual variance of the others
        self._residual = np.zeros(0)
        self.pivots = np.zeros(0, dtype=np.int64)
        self.others = np.zeros(0, dtype=np.int64)
        # rows subtracted since E was computed from C and N, and M's largest trace
        self._subtracted, self._largest = 0, 0.0

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
        """
        return _forward(self._C, cross.T).T

    def project(self, held: Array, own: Array, tolerance: float) -> Projection:
        """Project new rows on the columns held; O(k²) per row.

        Args:
            held: Their `coordinates`, shape (m, k).
            own: Their own block of K, shape (m, m).
            tolerance: Residual variance below which a row needs no column of its own;
                well above the error of K's entries.
        """
        # einsum: too little work to wake a threaded BLAS for
        beyond = own - np.einsum("ik,jk->ij", held, held)
        whitened = _forward(self._E, held.T)
        schur = np.eye(len(own)) + beyond + np.einsum("ki,kj->ij", whitened, whitened)
        new, chosen, left = incomplete_cholesky(beyond, tolerance)
        gain = _backward(self._E, whitened)
        return Projection(held, new, chosen, left, schur, gain)

    def append(
        self, projection: Projection, columns: Array, numbers: IntArray | None = None
    ) -> None:
        """Add projected rows; O(k²) per row, O(n k) per new column.

        Args:
            projection: Made by `project` since the last change.
            columns: Entries of K of the rows chosen with the others held, shape
                (p, n - k).
            numbers: Which rows they are, shape (m,); by default the next.
        """
        k, o, chosen = self.rank, len(self.others), projection.chosen
        m, p = projection.new.shape
        if numbers is None:
            numbers = np.arange(len(self), len(self) + m)
        rest = np.setdiff1d(np.arange(m), chosen)
        self._resize(k + p, o + len(rest))
        rows = projection.rows
        if p:
            self._N[k : k + p, :o] = self._new_columns(projection, columns)
            self._extend_factor(k, p, o)
            self._C = _bordered(self._C, np.tril(rows[chosen], k))
        self._N[: k + p, o : o + len(rest)] = rows[rest].T
        triangular_factor.update(self._E, np.ascontiguousarray(rows.T))
        self.pivots = np.concatenate([self.pivots, numbers[chosen]])
        self.others = np.concatenate([self.others, numbers[rest]])
        self._residual = np.concatenate([self._residual, projection.residual[rest]])

    def times(self, x: Array) -> Array:
        """R x, shape (n,).

        Args:
            x: One number per column, shape (k,).
        """
        out = np.empty(len(self))
        out[self.pivots] = self._C @ x
        out[self.others] = x @ self._coefficients
        return out

    def adjoint(self, y: Array) -> Array:
        """Rᵀ y, shape (k,).

        Args:
            y: One number per row, shape (n,).
        """
        part = self._coefficients @ y[self.others]
        return np.asarray(part + self._C.T @ y[self.pivots])

    def solve(self, right_side: Array) -> Array:
        """Solve (I + R Rᵀ) y = g, both of shape (n,)."""
        part = _forward(self._E, self.adjoint(right_side))
        return right_side - self.times(_backward(self._E, part))

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
        """
        going = (self.pivots >= start) & (self.pivots < start + count)
        places = np.flatnonzero(going)[::-1]
        self._resize(self.rank, len(self.others) + len(places))
        M = self._inner()
        lost = np.zeros((len(places), len(self.others) + len(places)))
        for row, q in zip(lost, places, strict=True):
            M, loss = self._demote_pivot(int(q), M)
            row[: len(loss)] = loss
        kept = self._drop(M, (self.others >= start) & (self.others < start + count))
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
        """
        self._drop(self._inner(), np.isin(self.others, rows))

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

    def _extend_factor(self, k: int, p: int, o: int) -> None:
        """Add rows k to k + p to E, from the entries of the others in the columns."""
        new = self._N[k : k + p, :o]
        beside = _forward(self._E, self._N[:k, :o] @ new.T)
        corner = np.eye(p) + new @ new.T - beside.T @ beside
        # M ≥ I, and so is each of its Schur complements
        values, vectors = np.linalg.eigh(corner)
        corner = (vectors * np.maximum(values, 1.0)) @ vectors.T
        self._E = _bordered(self._E, np.hstack([beside.T, np.linalg.cholesky(corner)]))

    def _demote_pivot(self, q: int, M: Array) -> tuple[Array, Array]:
        """Make pivot q one of the others; M then, and the dropped column, (n - k,)."""
        k, o = self.rank, len(self.others)
        self._N[:k, o] = self._C[q]
        cosines, sines = np.empty(k), np.empty(k)
        triangular_factor.delete_row(self._C, q, cosines, sines)
        self._C = np.ascontiguousarray(self._C[:-1, :-1])
        triangular_factor.rotate_rows(self._N[:, : o + 1], k, q, cosines, sines)
        for _ in range(2):  # GᵀMG by its rows, as M is symmetric
            triangular_factor.rotate_rows(M, k, q, cosines, sines)
            M = np.ascontiguousarray(M.T)
        loss = self._N[k - 1, : o + 1].copy()
        self._residual = np.append(self._residual, 0.0) + loss**2
        self.others = np.append(self.others, self.pivots[q])
        self.pivots = np.delete(self.pivots, q)
        return M[:-1, :-1], loss

    def _drop(self, M: Array, mask: NDArray[np.bool_]) -> IntArray:
        """Drop others; return the former places of the remaining ones."""
        o, k = len(self.others), self.rank
        gone = np.flatnonzero(mask)
        M = M - self._N[:k, gone] @ self._N[:k, gone].T
        left = o - len(gone)
        # the last ones move into the gaps
        kept = np.arange(left)
        holes = gone[gone < left]
        kept[holes] = left + np.flatnonzero(~mask[left:])
        self._N[:k, holes] = self._N[:k, kept[holes]]
        self.others, self._residual = self.others[kept], self._residual[kept]
        self._subtracted += len(gone)
        if self._subtracted >= len(self) or not self._factorised(M):
            self._refresh()
        self._resize(k, left)
        return kept

    def _inner(self) -> Array:
        """M, shape (k, k)."""
        M = self._E @ self._E.T
        self._largest = max(self._largest, float(np.trace(M)))
        return np.asarray(M)

    def _factorised(self, M: Array) -> bool:
        """Set E to the factor of M, if enough digits are left."""
        try:
            self._E = np.asarray(np.linalg.cholesky(M), np.float64)
        except np.linalg.LinAlgError:
            return False
        return self._largest <= LARGEST_FALL * float(np.trace(M))

    def _refresh(self) -> None:
        """Compute E from C and N; O(n k²)."""
        N = self._coefficients
        M = np.eye(self.rank) + self._C.T @ self._C + N @ N.T
        self._E = np.asarray(np.linalg.cholesky(M), np.float64)
        self._subtracted, self._largest = 0, 0.0

    def _resize(self, k: int, o: int) -> None:
        """Allocate N for k pivots and o others, with space to grow."""
        rows, columns = self._N.shape
        if k <= rows <= 2 * (k + MORE) and o <= columns <= 2 * (o + MORE):
            return
        grown = np.zeros((k + k // 16 + MORE, o + o // 16 + MORE))
        rows, columns = min(rows, len(grown)), min(columns, grown.shape[1])
        grown[:rows, :columns] = self._N[:rows, :columns]
        self._N = grown


def _bordered(E: Array, rows: Array) -> Array:
    """A triangle with p more rows, shape (p, k + p)."""
    k, size = len(E), len(E) + len(rows)
    out = np.zeros((size, size))
    out[:k, :k], out[k:] = E, rows
    return out


def _forward(E: Array, values: Array) -> Array:
    """E⁻¹ values, shape (k,) or (k, m)."""
    return np.asarray(solve_triangular(E, values, lower=True, check_finite=False))


def _backward(E: Array, values: Array) -> Array:
    """E⁻ᵀ values, shape (k,) or (k, m)."""
    return np.asarray(
        solve_triangular(E, values, trans=1, lower=True, check_finite=False)
    )
