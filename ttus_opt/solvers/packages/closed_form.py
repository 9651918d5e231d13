"""The closed form Q p = d (paper eqs. 11-13): form Q, factorise, solve.

The reference for all other solvers. SciPy's SuperLU is always available. MKL PARDISO is
the fastest factorisation measured. CHOLMOD comes through either of two packages:
scikit-sparse builds against the system's SuiteSparse (supernodal, with its BLAS) and
keeps the analysis for new weights; cholespy brings it in a wheel, without BLAS and much
slower (93 s where PARDISO took 8).
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import (
    Candidate,
    Capabilities,
    Claim,
    Prepared,
    Solver,
)
from ttus_opt.solvers.primal.elimination import factor

#: Rounds of iterative refinement: Q squares the condition of L, one round recovers the
#: lost digits
REFINEMENTS = 2

#: PARDISO's name for "real, symmetric positive definite"
SYMMETRIC_POSITIVE_DEFINITE = 2


@dataclass(frozen=True)
class Factor:
    """A factorisation of a symmetric positive definite Q.

    Attributes:
        solve: Solves Q x = d.
        refactorise: Takes new values in the same pattern; None where the package keeps
            no symbolic analysis.
        release: Frees memory that Python does not manage.
    """

    solve: Callable[[Array], Array]
    refactorise: Callable[[sp.csc_array], object] | None = None
    release: Callable[[], object] | None = None


class _Factorised(Prepared):
    """Q, d and a factor of Q."""

    _backend: ClosedForm
    _Q: sp.csc_array
    _factor: Factor | str = ""

    def update(self, program: Program) -> None:
        """Take other data; the factor is kept while Q stays the same."""
        Q, self._d = program.normal_equations()
        factor = self._factor
        if isinstance(factor, Factor):
            before, self._Q = self._Q, Q
            pattern = (
                Q.shape == before.shape
                and Q.nnz == before.nnz
                and np.array_equal(Q.indptr, before.indptr)
                and np.array_equal(Q.indices, before.indices)
            )
            if pattern and np.array_equal(Q.data, before.data):
                return
            if pattern and factor.refactorise is not None:
                factor.refactorise(Q)
                return
            if factor.release is not None:  # before the next factor is allocated
                factor.release()
        self._Q, self._factor = Q, _attempted(self._backend, Q)

    def solve(self) -> Candidate:
        """Solve Q x = d and refine."""
        if isinstance(self._factor, str):
            return Candidate(None, claim=Claim.GAVE_UP, detail=self._factor)
        x = self._factor.solve(self._d)
        for _ in range(REFINEMENTS):
            x = x + self._factor.solve(self._d - self._Q @ x)
        if not np.isfinite(x).all():
            return Candidate(None, claim=Claim.GAVE_UP, detail="Q is singular")
        return Candidate(x, iterations=1)


class ClosedForm(Solver):
    """Forms Q and d and factorises Q, by SuperLU where no subclass overrides it."""

    name = "closed_form"
    loaded = _Factorised
    summary = "forms Q and d and factorises Q (SciPy SuperLU): the reference"
    capabilities = Capabilities(
        inequalities=False,
        equalities=False,
        keeps="the factor of Q for new values; forms and factorises Q for new weights",
        time_limit=False,
    )

    def factorise(self, Q: sp.csc_array) -> Factor:
        """Factorise a symmetric positive definite matrix, all of it stored."""
        return Factor(factor(Q).solve)


class Pardiso(ClosedForm):
    """PARDISO on the upper triangle of Q."""

    name = "closed_form_pardiso"
    summary = "forms Q and d and factorises Q with MKL PARDISO"
    module = pip_name = "pypardiso"

    def factorise(self, Q: sp.csc_array) -> Factor:
        """Factorise the upper triangle."""
        from pypardiso import PyPardisoSolver

        pardiso = PyPardisoSolver(mtype=SYMMETRIC_POSITIVE_DEFINITE)
        # its adapter knows matrices only; the lower triangle in columns is the upper
        # one in rows
        upper = sp.csr_matrix(sp.tril(Q, format="csc").T)
        pardiso.factorize(upper)

        def solve(d: Array) -> Array:
            return np.asarray(pardiso.solve(upper, d)).reshape(-1)

        def release() -> None:
            pardiso.free_memory(everything=True)

        found = Factor(solve, release=release)
        # MKL's memory is not Python's: without this every fit would keep its factor
        weakref.finalize(found, release).atexit = False
        return found


class Cholmod(ClosedForm):
    """Supernodal CHOLMOD through scikit-sparse."""

    name = "closed_form_cholmod"
    summary = "forms Q and d and factorises Q with CHOLMOD (scikit-sparse)"
    module, pip_name = "sksparse", '"scikit-sparse<0.5"'

    def factorise(self, Q: sp.csc_array) -> Factor:
        """Supernodal Cholesky."""
        from sksparse.cholmod import (  # type: ignore[import-not-found,unused-ignore]
            cholesky,
        )

        found = cholesky(sp.csc_matrix(Q))
        return Factor(found, lambda other: found.cholesky_inplace(sp.csc_matrix(other)))


class Cholespy(ClosedForm):
    """CHOLMOD through cholespy."""

    name = "closed_form_cholespy"
    summary = "forms Q and d and factorises Q with CHOLMOD (cholespy's wheel)"
    module = pip_name = "cholespy"

    def factorise(self, Q: sp.csc_array) -> Factor:
        """Simplicial or supernodal, as CHOLMOD chooses."""
        from cholespy import (  # type: ignore[import-not-found,unused-ignore]
            CholeskySolverD,
            MatrixType,
        )

        found = CholeskySolverD(Q.shape[0], Q.indptr, Q.indices, Q.data, MatrixType.CSC)

        def solve(d: Array) -> Array:
            x = np.zeros_like(d)
            found.solve(np.ascontiguousarray(d), x)
            return x

        return Factor(solve)


def _attempted(solver: ClosedForm, Q: sp.csc_array) -> Factor | str:
    """A factor, or why the factorisation failed."""
    try:
        return solver.factorise(Q)
    except (RuntimeError, ValueError, ArithmeticError) as error:
        return f"Q cannot be factorised: {error}"


SOLVERS = [ClosedForm(), Pardiso(), Cholmod(), Cholespy()]
