"""The closed form Q p = d (paper eqs. 11-13): form Q, factorise, solve.

The reference for all other solvers. SciPy's SuperLU is always available; other
factorisations have files of their own (``closed_form_…``) over the classes here.
"""

from __future__ import annotations

import abc
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ttus_opt.core.arrays import Array
from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import (
    Candidate,
    Capabilities,
    Claim,
    Prepared,
    Request,
    Solver,
)

#: Rounds of iterative refinement: Q squares the condition of L, one round recovers the
#: lost digits
REFINEMENTS = 2


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


class ClosedFormSolver(Solver):
    """Forms Q and d; subclasses factorise."""

    capabilities = Capabilities(
        inequalities=False,
        equalities=False,
        keeps="the factor of Q for new values; forms and factorises Q for new weights",
        time_limit=False,
    )

    def prepare(self, program: Program, request: Request) -> Prepared:
        """Form Q and d and factorise Q."""
        self.require(program)
        return _Factorised(self, program)

    @abc.abstractmethod
    def factorise(self, Q: sp.csc_array) -> Factor:
        """Factorise a symmetric positive definite matrix, all of it stored."""


class ClosedForm(ClosedFormSolver):
    """SuperLU on Q in its symmetric mode."""

    name = "closed_form"
    summary = "forms Q and d and factorises Q (SciPy SuperLU): the reference"

    def factorise(self, Q: sp.csc_array) -> Factor:
        """Order Q itself and do not pivot: it is symmetric positive definite."""
        factor = splu(
            Q,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        return Factor(factor.solve)


class _Factorised(Prepared):
    """Q, d and a factor of Q."""

    def __init__(self, solver: ClosedFormSolver, program: Program) -> None:
        self._solver = solver
        self._Q, self._d = program.normal_equations()
        self._factor = _attempted(solver, self._Q)

    def update(self, program: Program) -> None:
        """Take other data; the factor is kept while Q stays the same."""
        Q, self._d = program.normal_equations()
        before, self._Q = self._Q, Q
        pattern = (
            Q.shape == before.shape
            and Q.nnz == before.nnz
            and np.array_equal(Q.indptr, before.indptr)
            and np.array_equal(Q.indices, before.indices)
        )
        factor = self._factor
        if isinstance(factor, Factor):
            if pattern and np.array_equal(Q.data, before.data):
                return
            if pattern and factor.refactorise is not None:
                factor.refactorise(Q)
                return
            if factor.release is not None:  # before the next factor is allocated
                factor.release()
        self._factor = _attempted(self._solver, Q)

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


def _attempted(solver: ClosedFormSolver, Q: sp.csc_array) -> Factor | str:
    """A factor, or why the factorisation failed."""
    try:
        return solver.factorise(Q)
    except (RuntimeError, ValueError, ArithmeticError) as error:
        return f"Q cannot be factorised: {error}"


SOLVERS = [ClosedForm()]
