"""Approximate inverse of a sparse positive definite matrix: a factor or multigrid.

The choice follows an estimate of the factor. In reverse Cuthill-McKee order the matrix
has an envelope of widths βᵢ, within which a factor needs Σ β numbers and Σ β²
operations (A. George, J. Liu, Computer Solution of Large Sparse Positive Definite
Systems, 1981). The envelope is narrow for rows along lines or over a surface, wide for
rows over a volume.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import reverse_cuthill_mckee

from ttus_opt.core.arrays import Array
from ttus_opt.core.optional import load
from ttus_opt.solvers.primal.elimination import factor

#: Most bytes of a factor; bytes of one of its entries with its index
MOST_BYTES, BYTES = 1 << 30, 12
#: Seconds per operation and per entry of the factor
OPERATION, NUMBER = 5e-10, 1e-7
#: Seconds of multigrid per entry of the matrix: set-up and some forty V-cycles
ENTRY = 1e-5
#: Part of the diagonal added, so that a singular matrix can be inverted [–]
SHIFT = 1e-10


@dataclass(frozen=True)
class Estimate:
    """Cost of a factor and of multigrid.

    Attributes:
        bytes: Memory of the factor.
        factor: Time of the factor [s].
        multigrid: Time of multigrid [s].
    """

    bytes: float
    factor: float
    multigrid: float

    @classmethod
    def of(cls, Q: sp.csr_array) -> Estimate:
        """From the pattern of a symmetric matrix."""
        order = reverse_cuthill_mckee(sp.csr_matrix(Q), symmetric_mode=True)
        place = np.empty(len(order), dtype=np.int64)
        place[order] = np.arange(len(order))
        rows = np.repeat(np.arange(Q.shape[0]), np.diff(Q.indptr))
        first = place.copy()
        np.minimum.at(first, rows, place[Q.indices])
        width = (place - first).astype(float)
        return cls(
            BYTES * float(width.sum()),
            OPERATION * float(width @ width) + NUMBER * float(width.sum()),
            ENTRY * Q.nnz,
        )

    @property
    def by_factor(self) -> bool:
        """Whether to factorise."""
        return self.bytes <= MOST_BYTES and self.factor <= self.multigrid


@dataclass(frozen=True)
class SparseInverse:
    """Approximate Q⁻¹, symmetric and positive definite.

    Attributes:
        apply: Q⁻¹ times a vector, shape (n,) each.
        description: The method, in words.
    """

    apply: Callable[[Array], Array] = field(repr=False)
    description: str

    @classmethod
    def of(cls, Q: sp.csr_array) -> SparseInverse:
        """Factorise, or set up a multigrid.

        Args:
            Q: Symmetric positive semidefinite, shape (n, n), diagonal not zero.

        Raises:
            MissingPackageError: Multigrid is needed, and pyamg is not installed.
        """
        shifted = sp.csr_array(Q + sp.diags_array(SHIFT * Q.diagonal()))
        if Estimate.of(Q).by_factor:
            return cls(factor(sp.csc_array(shifted)).solve, "a factor")
        return cls(_cycle(shifted), "algebraic multigrid")


def _cycle(Q: sp.csr_array) -> Callable[[Array], Array]:
    """One V-cycle of smoothed aggregation (Vaněk, Mandel and Brezina 1996)."""
    pyamg = load("pyamg", "reference")
    sweep = ("gauss_seidel", {"sweep": "symmetric"})
    # its kernels take 32-bit indices only
    indices, indptr = (index.astype(np.int32) for index in (Q.indices, Q.indptr))
    own = sp.csr_matrix((Q.data, indices, indptr), shape=Q.shape)
    levels = pyamg.smoothed_aggregation_solver(
        own, presmoother=sweep, postsmoother=sweep, max_coarse=500
    )
    operator = levels.aspreconditioner(cycle="V")
    return lambda v: np.asarray(operator.matvec(v))
