"""Lower triangular factors, changed in place by Givens rotations.

Source: Gill, Golub, Murray and Saunders, "Methods for modifying matrix factorizations",
Mathematics of Computation 28 (1974) 505-535.
"""

from __future__ import annotations

import math

import numpy as np

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.compiled import compiled

#: Columns rotated at a time, so that they stay in the L1 cache
TILE = 512


@compiled(nogil=True, fastmath={"contract"})
def update(E: Array, added: Array) -> None:
    """Make E the factor of E Eᵀ + W Wᵀ (compiled).

    Args:
        E: The factor, shape (k, k).
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


@compiled(nogil=True, fastmath={"contract"})
def delete_row(C: Array, q: int, cosines: Array, sines: Array) -> None:
    """Delete row q of C, and rotate columns until C is triangular again (compiled).

    Args:
        C: The factor, shape (k, k); its first k - 1 rows and columns remain.
        q: The row to delete.
        cosines: Set to those of the rotations of columns s and s + 1, in turn from
            s = q to k - 2, shape (k,).
        sines: Likewise.
    """
    for i in range(q + 1, len(C)):
        old, new = C[i], C[i - 1]
        new[:q] = old[:q]
        carried = old[q]
        for s in range(q, i - 1):
            value = old[s + 1]
            new[s] = cosines[s] * carried + sines[s] * value
            carried = cosines[s] * value - sines[s] * carried
        norm = math.hypot(carried, old[i])
        cosines[i - 1], sines[i - 1] = carried / norm, old[i] / norm
        new[i - 1] = norm


@compiled(nogil=True, fastmath={"contract"})
def rotate_rows(N: Array, k: int, q: int, cosines: Array, sines: Array) -> None:
    """Apply the rotations of `delete_row` to rows of N, shape (k, n) (compiled)."""
    n = N.shape[1]
    for low in range(0, n, TILE):
        high = min(low + TILE, n)
        for s in range(q, k - 1):
            c, d = cosines[s], sines[s]
            upper, lower = N[s, low:high], N[s + 1, low:high]
            for j in range(high - low):
                a, b = upper[j], lower[j]
                upper[j] = c * a + d * b
                lower[j] = c * b - d * a


#: Added to a pivot's variance, as a multiple of the tolerance, so that the factor stays
#: well conditioned when rows are nearly dependent
JITTER = 0.1

#: Least loss of a replacement over the largest; among these the newest row is taken, as
#: it stays longest
SHARE = 0.25


def incomplete_cholesky(B: Array, tolerance: float) -> tuple[Array, IntArray, Array]:
    """Pivoted incomplete Cholesky factor of a small matrix.

    Returns:
        The factor, triangular in its pivots' rows, shape (m, p); the pivots, shape
        (p,); the residual variances, shape (m,).
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


def replacements(
    lost: Array, residual: Array, numbers: IntArray, tolerance: float
) -> list[int]:
    """Rows that replace dropped columns, by a pivoted Cholesky factor.

    Args:
        lost: The dropped columns, shape (g, n).
        residual: Variance of each row outside all columns, shape (n,).
        numbers: Numbers of the rows, larger for newer ones, shape (n,).
        tolerance: Residual variance below which a row needs no column of its own.

    Returns:
        Their places among the n.
    """
    chosen: list[int] = []
    for _ in range(len(lost)):
        size = np.where(residual > tolerance, np.sum(lost**2, axis=0), 0.0)
        largest = float(size.max(initial=0.0))
        if largest <= tolerance:
            break
        enough = np.flatnonzero(size >= max(SHARE * largest, tolerance))
        best = int(enough[np.argmax(numbers[enough])])
        chosen.append(best)
        unit = lost[:, best] / math.sqrt(size[best])
        lost = lost - np.outer(unit, unit @ lost)
        lost[:, best] = 0.0
    return chosen
