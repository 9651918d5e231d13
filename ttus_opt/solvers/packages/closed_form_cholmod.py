"""The closed form Q p = d with CHOLMOD, through either of two packages.

scikit-sparse builds against the system's SuiteSparse (supernodal, with its BLAS) and
keeps the analysis for new weights; cholespy brings CHOLMOD in a wheel, without BLAS
and much slower (93 s where PARDISO took 8).
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.solvers.packages.closed_form import ClosedFormSolver, Factor


class ClosedFormCholmod(ClosedFormSolver):
    """CHOLMOD through scikit-sparse."""

    name = "closed_form_cholmod"
    summary = "forms Q and d and factorises Q with CHOLMOD (scikit-sparse)"
    module = "sksparse"
    pip_name = '"scikit-sparse<0.5"'

    def factorise(self, Q: sp.csc_array) -> Factor:
        """Supernodal Cholesky."""
        from sksparse.cholmod import (  # type: ignore[import-not-found,unused-ignore]
            cholesky,
        )

        factor = cholesky(sp.csc_matrix(Q))
        return Factor(
            factor, lambda other: factor.cholesky_inplace(sp.csc_matrix(other))
        )


class ClosedFormCholespy(ClosedFormSolver):
    """CHOLMOD through cholespy."""

    name = "closed_form_cholespy"
    summary = "forms Q and d and factorises Q with CHOLMOD (cholespy's wheel)"
    module = "cholespy"
    pip_name = "cholespy"

    def factorise(self, Q: sp.csc_array) -> Factor:
        """Simplicial or supernodal, as CHOLMOD chooses."""
        from cholespy import (  # type: ignore[import-not-found,unused-ignore]
            CholeskySolverD,
            MatrixType,
        )

        factor = CholeskySolverD(
            Q.shape[0], Q.indptr, Q.indices, Q.data, MatrixType.CSC
        )

        def solve(d: Array) -> Array:
            x = np.zeros_like(d)
            factor.solve(np.ascontiguousarray(d), x)
            return x

        return Factor(solve)


SOLVERS = [ClosedFormCholmod(), ClosedFormCholespy()]
