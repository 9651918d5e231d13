"""Lower triangular factors, changed in place by Givens rotations.

Source: Gill, Golub, Murray and Saunders, "Methods for modifying matrix factorizations",
Mathematics of Computation 28 (1974) 505-535.
"""

from __future__ import annotations

import math

import numpy as np

from ttus_opt.core.arrays import Array
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
