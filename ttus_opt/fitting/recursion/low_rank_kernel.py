"""A low-rank factor of K, the kernel of the measured rows, with updates and downdates.

Measurements at one place are nearly dependent, and K has far fewer large eigenvalues
than rows. A few rows are the basis; every measured row is a linear combination of them,
up to an error far below the measurement noise. With C the Cholesky factor of the
basis's block of K, the coordinates of a row are C⁻¹ times its entries of K with the
basis. They are the rows of R, n rows and k columns, and

    K ≈ R Rᵀ,   (I + R Rᵀ)⁻¹ = I - R M⁻¹Rᵀ,   M = I + RᵀR = E Eᵀ.

This is the Nyström approximation in its stable form (Foster et al., "Stable and
efficient Gaussian process calculations", J. Mach. Learn. Res. 10 (2009) 857-882).

Rows may be added and removed any number of times without loss of accuracy:

- C is built only from entries of K that were solved for, never from entries of R Rᵀ,
  whose error C⁻¹ has amplified and would amplify again.
- A row of the basis may stay when it is measured no more: the others need it. From time
  to time these are left out (`LowRankKernel.settle`); the rows that must replace them
  are returned, and the caller solves for their columns of K.
- What is removed is subtracted from M = E Eᵀ, and M recomputed when the basis settles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr, solve_triangular

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.compiled import compiled
from ttus_opt.gaussian.prior import pivoted_root

#: Least growth of the rows and columns of R [–]
MORE = 8

#: Fall of M's trace above which subtractions have lost too many digits [–]
LARGEST_FALL = 1e6

#: Rows removed, over those held, after which the basis settles [–]
WORN = 0.25

#: Added to a pivot's variance, as a multiple of the tolerance, so that the factor stays
#: well conditioned when rows are nearly dependent
JITTER = 0.1


@dataclass(frozen=True)
class Projection:
    """Rows projected on the columns of R.

    Attributes:
        held: Coordinates in the k present columns, shape (m, k).
        new: Coordinates in p new columns, shape (m, p).
        chosen: Those of the rows that bring the new columns, shape (p,).
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


class LowRankKernel:
    """R and E of the rows held.

    Attributes:
        basis: Number of every row of the basis; -1 if it is not held, shape (k,).
    """

    def __init__(self) -> None:
        # E below the diagonal, from the second row on, and Cᵀ above
        self._factors: Array = np.zeros((1, 0))
        self._space: Array = np.zeros((MORE, MORE))
        # variance of every row outside R's columns
        self._residual = np.zeros(0)
        self.basis = np.zeros(0, dtype=np.int64)
        # rows subtracted since E was computed from R, and M's largest trace
        self._subtracted, self._largest = 0, 0.0

    def __len__(self) -> int:
        """Number of rows n [–]."""
        return len(self._residual)

    @property
    def rank(self) -> int:
        """Number of columns k [–]."""
        return len(self.basis)

    @property
    def R(self) -> Array:
        """R, shape (n, k)."""
        return self._space[: len(self), : self.rank]

    @property
    def memory_bytes(self) -> int:
        """Size of all arrays, unused space included."""
        arrays = (self._factors, self._space, self._residual, self.basis)
        return sum(a.nbytes for a in arrays)

    @property
    def is_worn(self) -> bool:
        """Whether so many rows were removed that the basis should settle."""
        return self._subtracted > WORN * len(self)

    def coordinates(self, cross: Array) -> Array:
        """Coordinates of rows in the columns held, shape (m, k); O(k²) per row.

        Args:
            cross: Their entries of K with the basis, shape (m, k).
        """
        solved = solve_triangular(
            self._factors[:-1], cross.T, trans=1, check_finite=False
        )
        return np.asarray(solved.T)

    def project(self, held: Array, own: Array, tolerance: float) -> Projection:
        """Project rows on the columns held; O(k²) per row.

        Args:
            held: Their `coordinates`, shape (m, k).
            own: Their own block of K, shape (m, m).
            tolerance: Residual variance below which a row needs no column of its own;
                well above the error of K's entries.
        """
        # einsum: too little work to wake a threaded BLAS for
        beyond = own - np.einsum("ik,jk->ij", held, held)
        whitened = self._forward(held.T)
        schur = np.eye(len(own)) + beyond + np.einsum("ki,kj->ij", whitened, whitened)
        jitter = JITTER * tolerance
        new, chosen = pivoted_root(
            beyond + jitter * np.eye(len(own)), tolerance + jitter
        )
        left = np.maximum(np.diag(beyond) - (new**2).sum(axis=1), 0.0)
        return Projection(held, new, chosen, left, schur, self._backward(whitened))

    def extend(self, projection: Projection, columns: Array, numbers: IntArray) -> None:
        """Add columns for the rows that bring them; O(n k) each.

        Args:
            projection: Made by `project` since the last change.
            columns: Entries of K of these rows with all rows held, shape (p, n).
            numbers: Of these rows, shape (p,).
        """
        if not len(numbers):
            return
        n, k, p = len(self), self.rank, len(numbers)
        held, corner = (
            part[projection.chosen] for part in (projection.held, projection.new)
        )
        new = columns - held @ self.R.T
        for j, row in enumerate(new):
            row -= corner[j, :j] @ new[:j]
            row /= corner[j, j]
            # up to rounding, an entry is at most the root of the residual variance
            most = np.sqrt(self._residual)
            np.clip(row, -most, most, out=row)
            self._residual = np.maximum(self._residual - row**2, 0.0)
        beside = self._forward(self.R.T @ new.T)
        left = np.eye(p) + new @ new.T - beside.T @ beside
        # M ≥ I, and so is each of its Schur complements
        values, vectors = np.linalg.eigh(left)
        left = (vectors * np.maximum(values, 1.0)) @ vectors.T
        factors = np.zeros((k + p + 1, k + p))
        factors[: k + 1, :k] = self._factors
        factors[k + 1 :] += np.hstack([beside.T, np.linalg.cholesky(left)])
        factors[:-1, k:] += np.hstack([held, np.tril(corner)]).T
        self._factors = factors
        self._resize(n, k + p)
        self._space[:n, k : k + p] = new.T
        self.basis = np.concatenate([self.basis, numbers])

    def append(self, projection: Projection, columns: Array) -> None:
        """Add projected rows, and the columns they bring; O(k²) per row.

        Args:
            projection: Made by `project` since the last change.
            columns: As in `extend`.
        """
        n = len(self)
        self.extend(projection, columns, n + projection.chosen)
        rows = np.hstack([projection.held, projection.new])
        self._resize(n + len(rows), self.rank)
        self._residual = np.concatenate([self._residual, projection.residual])
        self.R[n:] = rows
        update(self._factors[1:], np.ascontiguousarray(rows.T))

    def solve(self, right_side: Array) -> Array:
        """Solve (I + R Rᵀ) y = g, both of shape (n,)."""
        part = self._forward(self.R.T @ right_side)
        return np.asarray(right_side - self.R @ self._backward(part))

    def remove(self, start: int, count: int) -> None:
        """Remove rows start to start + count; O(n k + k³).

        Args:
            start: First row.
            count: Number of rows.
        """
        end, n = start + count, len(self)
        E = np.tril(self._factors[1:])
        M = E @ E.T
        self._largest = max(self._largest, float(np.trace(M)))
        gone = self.R[start:end]
        M -= gone.T @ gone
        self._space[start : n - count] = self._space[end:n]
        self._residual = np.delete(self._residual, slice(start, end))
        going = (self.basis >= start) & (self.basis < end)
        self.basis = np.where(self.basis >= end, self.basis - count, self.basis)
        self.basis[going] = -1
        self._subtracted += count
        try:
            self._factorise(M)
            lost = self._largest > LARGEST_FALL * float(np.trace(M))
        except np.linalg.LinAlgError:
            lost = True
        if lost:
            self._refresh()
        self._resize(n - count, self.rank)

    def settle(self, tolerance: float) -> IntArray:
        """Leave out what is in the basis and not held; O(n k²).

        Args:
            tolerance: As in `project`.

        Returns:
            Numbers of the rows that replace it: `extend` by them, or the residual
            variance of what they explain stays large.
        """
        stays = self.basis >= 0
        a = int(stays.sum())
        if a == self.rank:
            self._refresh()
            return np.zeros(0, dtype=np.int64)
        turn, corner = qr(np.triu(self._factors[:-1])[:, stays])
        turned = self.R @ turn
        lost = turned[:, a:]
        self._factors = np.vstack([corner[:a], np.zeros((1, a))])
        self.basis = self.basis[stays]
        self._resize(len(self), a)
        self.R[:] = turned[:, :a]
        self._residual = self._residual + (lost**2).sum(axis=1)
        self._refresh()
        size, rows = qr(lost.T, mode="r", pivoting=True)
        size = np.diagonal(size) ** 2
        return np.asarray(rows[: len(size)][size > tolerance], dtype=np.int64)

    def scale(self, factor: float) -> None:
        """Multiply the rows held by a number; O(n k²)."""
        self.R[:] *= factor
        self._residual *= factor**2
        self._refresh()

    def _refresh(self) -> None:
        """Compute E from R; O(n k²)."""
        M = np.eye(self.rank) + self.R.T @ self.R
        self._factorise(M)
        self._subtracted, self._largest = 0, 0.0

    def _factorise(self, M: Array) -> None:
        """Replace E by the factor of M."""
        self._factors[1:] = np.triu(self._factors[1:], 1) + np.linalg.cholesky(M)

    def _forward(self, values: Array) -> Array:
        """E⁻¹ values, shape (k,) or (k, m)."""
        E = self._factors[1:]
        return np.asarray(solve_triangular(E, values, lower=True, check_finite=False))

    def _backward(self, values: Array) -> Array:
        """E⁻ᵀ values, shape (k,) or (k, m)."""
        E = self._factors[1:]
        return np.asarray(
            solve_triangular(E, values, trans=1, lower=True, check_finite=False)
        )

    def _resize(self, n: int, k: int) -> None:
        """Allocate R for n rows and k columns, with space to grow."""
        rows, columns = self._space.shape
        if n <= rows <= 2 * (n + MORE) and k <= columns <= 2 * (k + MORE):
            return
        grown = np.zeros((n + n // 32 + MORE, k + k // 32 + MORE))
        rows, columns = min(rows, len(grown)), min(columns, grown.shape[1])
        grown[:rows, :columns] = self._space[:rows, :columns]
        self._space = grown


@compiled(nogil=True, fastmath={"contract"})
def update(E: Array, added: Array) -> None:
    """Make E the factor of E Eᵀ + W Wᵀ, by rotations (compiled).

    Source: Gill, Golub, Murray and Saunders, "Methods for modifying matrix
    factorizations", Mathematics of Computation 28 (1974) 505-535.

    Args:
        E: The lower factor, overwritten, shape (k, k).
        added: W, overwritten, shape (k, m).
    """
    k, m = added.shape
    cosines, sines = np.empty((k, m)), np.empty((k, m))
    for j in range(k):
        row, rest = E[j], added[j]
        for q in range(j):
            value, c, s = row[q], cosines[q], sines[q]
            for a in range(m):
                w = rest[a]
                rest[a] = c[a] * w - s[a] * value
                value = c[a] * value + s[a] * w
            row[q] = value
        value = row[j]
        for a in range(m):
            norm = math.sqrt(value * value + rest[a] * rest[a])
            cosines[j, a], sines[j, a] = value / norm, rest[a] / norm
            value = norm
        row[j] = value
