"""Cone solvers reached through cvxpy, a row each: they take every penalty and cones."""

from __future__ import annotations

import math
import warnings

from ttus_opt.problem.cvxpy_form import CvxpyProgram
from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import (
    Candidate,
    Capabilities,
    Claim,
    Prepared,
    Request,
    Solver,
)
from ttus_opt.solvers.package import Package
from ttus_opt.solvers.sizes import interior_point_seconds
from ttus_opt.solvers.verified import Verified


class CvxpySolver(Solver):
    """One of cvxpy's cone solvers, called there as its package in capitals."""

    capabilities = Capabilities(inequalities=True, equalities=True, nonquadratic=True)

    def __init__(self, package: Package) -> None:
        self.package = package
        self.name, self.summary = package.name, package.summary
        self.module, self.pip_name = package.module, f"cvxpy {package.module}"

    @property
    def estimates(self) -> bool:
        """Whether its row has an estimate."""
        return self.package.cost is not None

    def cost(self, program: Program) -> float:
        """The estimate of its row."""
        return self.package.cost(program) if self.package.cost else math.inf

    def prepare(self, program: Program, request: Request) -> Prepared:
        """State the program in cvxpy."""
        self.require(program)
        return _Loaded(self.package, program, request)


class _Loaded(Verified):
    """A program in cvxpy's terms; nothing is kept between solves."""

    def __init__(self, package: Package, program: Program, request: Request) -> None:
        self._package, self.margin = package, package.margin
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
                    solver=self._package.module.upper(),
                    **self._package.options(eps, seconds),
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

SOLVERS = [
    CvxpySolver(
        Package(
            "cvxpy_clarabel",
            "interior point through cvxpy (Clarabel): any penalty",
            "clarabel",
            ("tol_gap_abs", "tol_gap_rel", "tol_feas"),
            time_limit="time_limit",
            # and of stating it in cvxpy
            cost=lambda program: 0.05 + 1.1 * interior_point_seconds(program),
        )
    ),
    CvxpySolver(
        Package(
            "cvxpy_scs",
            "splitting through cvxpy (SCS): any penalty",
            "scs",
            ("eps_rel",),
            absolute=("eps_abs",),
            time_limit="time_limit_secs",
            fixed={"max_iters": 20_000},
        )
    ),
    CvxpySolver(
        Package(
            "cvxpy_mosek",
            "interior point through cvxpy (MOSEK, commercial): any penalty",
            "mosek",
            tuple(
                f"MSK_DPAR_INTPNT_CO_TOL_{which}"
                for which in ("PFEAS", "DFEAS", "REL_GAP", "MU_RED")
            ),
            time_limit="MSK_DPAR_OPTIMIZER_MAX_TIME",
            within="mosek_params",
        )
    ),
]
