"""Lower triangular factors in packed rows, with updates and downdates in place.

Row i starts at i(i + 1)/2 and has i + 1 entries. Updates follow Gill, Golub, Murray and
Saunders, "Methods for modifying matrix factorizations", Mathematics of Computation 28
(1974) 505-535. They are as accurate as a new factorisation; a downdate loses digits:
Bojanczyk, Brent, Van Dooren and de Hoog, "A note on downdating the Cholesky
factorization", SIAM J. Sci. Stat. Comput. 8 (1987) 210-221.
"""

from __future__ import annotations

import math

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.compiled import compiled

#: Least pivot of a downdate [–]; below, too many digits are lost
LEAST_LEFT = 1e-6

#: Columns rotated at a time, so that they stay in the L1 cache
TILE = 512


def packed_size(k: int) -> int:
    """Number of entries of a factor with k rows."""
    return k * (k + 1) // 2


def packed(A: Array) -> Array:
    """The lower triangle of a matrix, shape (k(k + 1)/2,)."""
    return np.asarray(A[np.tril_indices(len(A))], np.float64)


def unpacked(E: Array, k: int) -> Array:
    """The first k rows as a matrix, shape (k, k)."""
    out = np.zeros((k, k))
    out[np.tril_indices(k)] = E[: packed_size(k)]
    return out


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
def forward(E: Array, x: Array) -> None:
    """Solve E x = g for the rows of x, in place (compiled)."""
    start = 0
    for j in range(x.shape[1]):
        row = E[start : start + j]
        for c in range(len(x)):
            x[c, j] = (x[c, j] - _dot(row, x[c, :j])) / E[start + j]
        start += j + 1


@compiled(nogil=True)
def backward(E: Array, y: Array) -> None:
    """Solve Eᵀ y = z, in place (compiled)."""
    for j in range(len(y) - 1, -1, -1):
        start = j * (j + 1) // 2
        y[j] /= E[start + j]
        _take(y, y[j], E[start : start + j])


@compiled(nogil=True)
def times(E: Array, x: Array, out: Array) -> None:
    """Set out to E x (compiled)."""
    start = 0
    for j in range(len(x)):
        out[j] = _dot(E[start : start + j + 1], x[: j + 1])
        start += j + 1


@compiled(nogil=True)
def add_adjoint(E: Array, y: Array, out: Array) -> None:
    """Add Eᵀ y to out (compiled)."""
    start = 0
    for j in range(len(y)):
        _take(out, -y[j], E[start : start + j + 1])
        start += j + 1


@compiled(nogil=True, fastmath={"contract"})
def update(E: Array, added: Array) -> None:
    """Make E the factor of E Eᵀ + W Wᵀ by Givens rotations, in place (compiled).

    Args:
        E: The factor.
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
def downdate(E: Array, gone: Array) -> bool:
    """Make E the factor of E Eᵀ - Σ w wᵀ, row w after row, in place (compiled).

    Args:
        E: The factor.
        gone: Rows w, overwritten, shape (m, k).

    Returns:
        Whether enough digits are left; if not, E is invalid.
    """
    m, k = gone.shape
    cosines, sines = np.empty(k), np.empty(k)
    for a in range(m):
        w = gone[a : a + 1]
        forward(E, w)
        left = 1.0 - _dot(w[0], w[0])
        if not left >= LEAST_LEFT:
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


@compiled(nogil=True, fastmath={"contract"})
def delete_row(C: Array, k: int, q: int, cosines: Array, sines: Array) -> None:
    """Delete row q of C, and rotate columns until C is triangular again (compiled).

    Args:
        C: The factor; k - 1 rows remain.
        k: Number of rows.
        q: The row to delete.
        cosines: Set to those of the rotations of columns s and s + 1, in turn from
            s = q to k - 2, shape (k,).
        sines: Likewise.
    """
    for i in range(q + 1, k):
        old, new = i * (i + 1) // 2, (i - 1) * i // 2
        for s in range(q):
            C[new + s] = C[old + s]
        carried = C[old + q]
        for s in range(q, i - 1):
            value = C[old + s + 1]
            C[new + s] = cosines[s] * carried + sines[s] * value
            carried = cosines[s] * value - sines[s] * carried
        norm = math.hypot(carried, C[old + i])
        cosines[i - 1], sines[i - 1] = carried / norm, C[old + i] / norm
        C[new + i - 1] = norm


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


@compiled(nogil=True, fastmath={"contract"})
def rotate_factor(E: Array, k: int, q: int, cosines: Array, sines: Array) -> None:
    """Make E the factor of Gᵀ E Eᵀ G, G the rotations of `delete_row` (compiled)."""
    for s in range(q, k - 1):
        _turn(E, s, cosines[s], sines[s], k)


@compiled(nogil=True)
def _turn(E: Array, q: int, c: float, s: float, k: int) -> None:
    """Turn rows q and q + 1 of E, and columns until it is triangular (compiled)."""
    top, low = q * (q + 1) // 2, (q + 1) * (q + 2) // 2
    for i in range(q + 1):
        a, b = E[top + i], E[low + i]
        E[top + i], E[low + i] = c * a + s * b, c * b - s * a
    # row q has got an entry beyond its diagonal
    beyond, E[low + q + 1] = s * E[low + q + 1], c * E[low + q + 1]
    norm = math.hypot(E[top + q], beyond)
    c, s = E[top + q] / norm, beyond / norm
    E[top + q] = norm
    # turns keep the determinant, so that the diagonal stays positive
    for i in range(q + 1, k):
        at = i * (i + 1) // 2 + q
        E[at], E[at + 1] = c * E[at] + s * E[at + 1], c * E[at + 1] - s * E[at]
