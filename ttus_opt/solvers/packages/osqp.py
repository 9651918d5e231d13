"""OSQP: operator splitting (ADMM) with one factor kept over all iterations, in C.

Used directly, not through qpsolvers, to keep the solver object: new measured values
change only limits (same factor, warm start), new weights change values of A
(refactorisation in the same ordering).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Candidate, Capabilities, Claim, Request, Solver
from ttus_opt.solvers.packages.qp_packages import claim_from
from ttus_opt.solvers.packages.quadratic import TwoSided, read_back
from ttus_opt.solvers.sizes import splitting_seconds
from ttus_opt.solvers.verified import Verified

#: Iterations between two checks of the iterate, and most checks
ITERATIONS, CHECKS = 5_000, 40


class Osqp(Solver):
    """OSQP on the least-squares form."""

    name = "osqp"
    summary = "operator splitting (OSQP), keeps its factor and its last answer"
    capabilities = Capabilities(
        inequalities=True,
        equalities=True,
        keeps="factor and last answer for new values; the ordering for new weights",
    )
    module = "osqp"
    pip_name = "osqp"

    def cost(self, program: Program) -> float:
        """That of a splitting method with a slower factor."""
        return 3.0 * splitting_seconds(program)

    def prepare(self, program: Program, request: Request) -> Verified:
        """Load, scale and factorise."""
        self.require(program)
        return _Loaded(program, request)


class _Loaded(Verified):
    """A live OSQP object."""

    margin = 0.1
    floor = 1e-12
    continuations = CHECKS

    def __init__(self, program: Program, request: Request) -> None:
        self._rows: TwoSided | None = None
        self._solver: Any = None
        super().__init__(program, request)

    def _load(self, program: Program) -> None:
        self._form = program.least_squares_qp()
        rows = TwoSided.of(self._form)
        kept = self._solver is not None and self._rows is not None
        if kept and self._rows is not None and rows.same_structure(self._rows):
            changed: dict[str, Any] = {}
            if not np.array_equal(rows.A.data, self._rows.A.data):
                changed["Ax"] = rows.A.data
            if not np.array_equal(rows.P.data, self._rows.P.data):
                changed["Px"] = sp.triu(rows.P, format="csc").data
            self._solver.update(q=rows.q, l=rows.lower, u=rows.upper, **changed)
        else:
            self._solver = self._set_up(rows)
        self._rows = rows

    def _set_up(self, rows: TwoSided) -> Any:
        """A factorised solver; None where OSQP refuses the data."""
        import osqp

        solver = osqp.OSQP()
        try:
            solver.setup(
                sp.csc_matrix(sp.triu(rows.P)),
                rows.q,
                rows.A,
                rows.lower,
                rows.upper,
                verbose=False,
                eps_abs=self._eps * 1e-2,
                eps_rel=self._eps,
                max_iter=ITERATIONS,
                polishing=False,
            )
        except osqp.OSQPException:
            return None
        return solver

    def _attempt(self, eps: float, seconds: float | None) -> Candidate:
        assert self._rows is not None
        if self._solver is None:
            return Candidate(None, claim=Claim.GAVE_UP, detail="OSQP refuses the data")
        # residuals here are often far below one: the default absolute tolerance would
        # accept a dual residual of 1e-2
        self._solver.update_settings(
            eps_abs=eps * 1e-2,
            eps_rel=eps,
            time_limit=1e10 if seconds is None else seconds,
        )
        answer = self._solver.solve(raise_error=False)
        words = str(answer.info.status)
        rows, box = self._rows.split(np.asarray(answer.y, dtype=np.float64))
        x = np.asarray(answer.x, dtype=np.float64)
        claim = claim_from(words, words == "solved")
        if claim is Claim.DOUBTS:  # "solved inaccurate": it ran out of iterations
            claim = Claim.PAUSED
        if claim in (Claim.INFEASIBLE, Claim.UNBOUNDED):
            return Candidate(None, claim=claim, detail=words)
        return read_back(
            self._program,
            self._form,
            x,
            rows,
            box,
            iterations=int(answer.info.iter),
            claim=claim,
            detail=words,
        )


SOLVERS = [Osqp()]
