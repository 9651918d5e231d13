"""The closed form Q p = d with MKL PARDISO, the fastest factorisation measured."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.solvers.packages.closed_form import ClosedFormSolver, Factor

#: PARDISO's name for "real, symmetric positive definite"
SYMMETRIC_POSITIVE_DEFINITE = 2


class ClosedFormPardiso(ClosedFormSolver):
    """PARDISO on the upper triangle of Q."""

    name = "closed_form_pardiso"
    summary = "forms Q and d and factorises Q with MKL PARDISO"
    module = "pypardiso"
    pip_name = "pypardiso"

    def factorise(self, Q: sp.csc_array) -> Factor:
        """Factorise the upper triangle."""
        pardiso = _Pardiso(Q)
        return Factor(pardiso.solve, release=pardiso.release)


class _Pardiso:
    def __init__(self, Q: sp.csc_array) -> None:
        from pypardiso import PyPardisoSolver

        self._pardiso: Any = PyPardisoSolver(mtype=SYMMETRIC_POSITIVE_DEFINITE)
        # its adapter knows matrices only; the lower triangle in columns is the upper
        # one in rows
        self._upper = sp.csr_matrix(sp.tril(Q, format="csc").T)
        self._pardiso.factorize(self._upper)

    def solve(self, d: Array) -> Array:
        return np.asarray(self._pardiso.solve(self._upper, d)).reshape(-1)

    def release(self) -> None:
        self._pardiso.free_memory(everything=True)

    def __del__(self) -> None:
        # MKL's memory is not Python's: without this every fit would keep its factor
        if hasattr(self, "_pardiso"):
            self.release()


SOLVERS = [ClosedFormPardiso()]
