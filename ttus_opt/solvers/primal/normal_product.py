"""MᵀC M v in one pass over the rows of M.

Two sparse products read the matrix twice and store M v. Here each row is read once, and
a row with zero slope (beyond a kink) not at all.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.core.compiled import compiled

Indices = NDArray[np.int32] | NDArray[np.int64]


def add_normal_product(
    out: Array, matrix: sp.csr_array, slope: Array, v: Array
) -> None:
    """Add MᵀC M v to a vector.

    Args:
        out: Changed, shape (n,).
        matrix: M, shape (m, n).
        slope: Diagonal of C, shape (m,).
        v: Shape (n,).
    """
    _add(matrix.indptr, matrix.indices, matrix.data, slope, v, out)


@compiled(nogil=True)
def _add(
    indptr: Indices, indices: Indices, data: Array, slope: Array, v: Array, out: Array
) -> None:
    """`add_normal_product` on the arrays of M in CSR (compiled)."""
    for row in range(slope.size):
        factor = slope[row]
        if factor == 0.0:
            continue
        start, end = indptr[row], indptr[row + 1]
        value = 0.0
        for k in range(start, end):
            value += data[k] * v[indices[k]]
        value *= factor
        for k in range(start, end):
            out[indices[k]] += value * data[k]
