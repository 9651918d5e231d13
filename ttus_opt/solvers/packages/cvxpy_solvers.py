"""Cone solvers reached through cvxpy, a row each: they take every penalty and cones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ttus_opt.problem.cvxpy_form import CvxpyProgram
from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Candidate, Claim
from ttus_opt.solvers.packages.package import PackageLoaded, PackageSolver


class _Loaded(PackageLoaded):
    """A program in cvxpy's terms."""

    def _load(self, program: Program) -> None:
        self._form = CvxpyProgram.of(program)

    def _solved(self, options: Mapping[str, Any]) -> None:
        self._form.problem.solve(solver=self._backend.module.upper(), **options)

    def _read(self, answer: None) -> Candidate:
        words = str(self._form.problem.status)
        claim = _CLAIMS.get(words, Claim.GAVE_UP)
        x = self._form.point()
        if x is None:
            return Candidate(None, claim=claim, detail=words)
        stats = self._form.problem.solver_stats
        iterations = int(stats.num_iters or 0) if stats is not None else 0
        return Candidate(x, self._form.duals(), iterations, claim, words)

    def _errors(self) -> tuple[type[Exception], ...]:
        import cvxpy as cp

        return (cp.error.SolverError,)


class CvxpySolver(PackageSolver):
    """One of cvxpy's cone solvers, called there as its package in capitals."""

    loaded = _Loaded
    nonquadratic = True

    def cost(self, program: Program) -> float:
        """Building the problem in cvxpy included."""
        return 0.05 + super().cost(program)


_CLAIMS = {
    "optimal": Claim.DONE,
    "infeasible": Claim.INFEASIBLE,
    "optimal_inaccurate": Claim.DOUBTS,
    "unbounded": Claim.UNBOUNDED,
    "user_limit": Claim.TIME_LIMIT,
}


SOLVERS = [
    CvxpySolver(
        "cvxpy_clarabel",
        "interior point through cvxpy (Clarabel): any penalty",
        "clarabel",
        ("tol_gap_abs", "tol_gap_rel", "tol_feas"),
        time_limit="time_limit",
        pip_name="cvxpy clarabel",
        effort=1.1,
    ),
    CvxpySolver(
        "cvxpy_scs",
        "splitting through cvxpy (SCS): any penalty",
        "scs",
        ("eps_rel",),
        absolute=("eps_abs",),
        time_limit="time_limit_secs",
        fixed={"max_iters": 20_000},
        pip_name="cvxpy scs",
    ),
    CvxpySolver(
        "cvxpy_mosek",
        "interior point through cvxpy (MOSEK, commercial): any penalty",
        "mosek",
        tuple(
            f"MSK_DPAR_INTPNT_CO_TOL_{which}"
            for which in ("PFEAS", "DFEAS", "REL_GAP", "MU_RED")
        ),
        time_limit="MSK_DPAR_OPTIMIZER_MAX_TIME",
        within="mosek_params",
        pip_name="cvxpy mosek",
    ),
]
