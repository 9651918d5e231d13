"""A cone solver reached through cvxpy: takes every penalty and cones."""

from __future__ import annotations

import abc
import importlib.util
import warnings
from typing import Any

from ttus_opt.problem.cvxpy_form import CvxpyProgram
from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Candidate, Claim, Prepared, Request, Solver
from ttus_opt.solvers.verified import Verified


class CvxpySolver(Solver):
    """One of cvxpy's cone solvers."""

    #: Its name in cvxpy
    backend: str
    #: First tolerance handed to the package, as a part of the one asked for
    margin: float = 0.1

    @property
    def installed(self) -> bool:
        """Whether the solver and cvxpy can be found."""
        return super().installed and importlib.util.find_spec("cvxpy") is not None

    @abc.abstractmethod
    def options(self, eps: float, seconds: float | None) -> dict[str, Any]:
        """A tolerance and a time limit in the package's own words.

        Args:
            eps: Its own relative tolerance [–].
            seconds: Most time it may take; None for no limit [s].

        Returns:
            Keywords of ``cvxpy.Problem.solve``.
        """

    def prepare(self, program: Program, request: Request) -> Prepared:
        """State the program in cvxpy."""
        self.require(program)
        return _Loaded(self, program, request)


class _Loaded(Verified):
    """A program in cvxpy's terms; nothing is kept between solves."""

    def __init__(self, solver: CvxpySolver, program: Program, request: Request) -> None:
        self._solver = solver
        self.margin = solver.margin
        super().__init__(program, request)

    def _load(self, program: Program) -> None:
        self._form = CvxpyProgram.of(program)

    def _attempt(self, eps: float, seconds: float | None) -> Candidate:
        import cvxpy as cp

        with warnings.catch_warnings():
            # "solution may be inaccurate": checked here in any case
            warnings.simplefilter("ignore")
            try:
                self._form.problem.solve(
                    solver=self._solver.backend, **self._solver.options(eps, seconds)
                )
            except cp.error.SolverError as error:
                said = f"{type(error).__name__}: {error}"
                return Candidate(None, claim=Claim.GAVE_UP, detail=said)
        words = str(self._form.problem.status)
        claim = _CLAIMS.get(words, Claim.GAVE_UP)
        x = self._form.point()
        if x is None:
            return Candidate(None, claim=claim, detail=words)
        stats = self._form.problem.solver_stats
        iterations = int(stats.num_iters or 0) if stats is not None else 0
        return Candidate(x, self._form.duals(), iterations, claim, words)


_CLAIMS = {
    "optimal": Claim.DONE,
    "infeasible": Claim.INFEASIBLE,
    "optimal_inaccurate": Claim.DOUBTS,
    "unbounded": Claim.UNBOUNDED,
    "user_limit": Claim.TIME_LIMIT,
}
