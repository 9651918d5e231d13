"""Choice of pivots for a low-rank factor: Cholesky factors with pivoting.

Used by `ttus_opt.fitting.recursion.low_rank_kernel`.
"""

from __future__ import annotations

import math

import numpy as np

from ttus_opt.core.arrays import Array, IntArray

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
