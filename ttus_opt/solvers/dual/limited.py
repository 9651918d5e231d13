"""A loaded program with limits: its working sets, infeasibility."""

from __future__ import annotations

import abc

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.laplace.system import RTOL
from ttus_opt.problem.verify.kkt import Duals
from ttus_opt.solvers.base import Candidate, Claim
from ttus_opt.solvers.dual.active_set import (
    DUAL_MARGIN,
    LimitedProblem,
    primal_dual_active_set,
)
from ttus_opt.solvers.dual.limits import SpokeLimits
from ttus_opt.solvers.dual.solver import Accuracy
from ttus_opt.solvers.dual.working_set import WorkingSet
from ttus_opt.solvers.verified import Verified


class Limited(Verified):
    """A program with its last working set.

    Each attempt takes a smaller residual of the dual, which is relative to the
    measurements, while the tolerance is to what is left where these nearly cancel.
    """

    margin, floor, patient = DUAL_MARGIN, 0.0, False
    tightenings, tightening = 3, (1e-3, 1e-3)
    tightened_after = (Claim.DONE, Claim.GAVE_UP)
    _problem: LimitedProblem
    _last: tuple[Array, WorkingSet] | None = None

    def start_at(self, x: Array, duals: Duals) -> None:
        """Start from the active limits of a point."""
        self._last = self._problem.start(x, duals)

    def solve(self) -> Candidate:
        """Solve working sets; a program without limits as it is."""
        self._eps = max(self._request.tolerance * self.margin, RTOL)
        limited = self._problem.limits.binding
        contradiction = self._contradiction() if limited else None
        return contradiction or super().solve()

    def _attempt(self, eps: float, deadline: float | None) -> Candidate:
        accuracy = Accuracy(eps, deadline=deadline)
        limited = self._problem.limits.binding
        return (self._limited if limited else self._unlimited)(accuracy)

    def _limited(self, accuracy: Accuracy) -> Candidate:
        """The minimiser within the limits, from the last working set."""
        problem = self._problem
        answer = primal_dual_active_set(
            problem, self._last, self._request.tolerance, accuracy
        )
        x, claim = problem.variables(answer.p), Claim.GAVE_UP
        if answer.settled:
            self._last, claim = (answer.p, answer.active), Claim.DONE
        elif answer.late:
            claim = Claim.TIME_LIMIT
        detail = f"{answer.sets} working sets, {answer.active.count} active limits"
        duals = problem.duals(x, answer.multipliers)
        return Candidate(x, duals, answer.steps, claim, detail)

    @abc.abstractmethod
    def _unlimited(self, accuracy: Accuracy) -> Candidate:
        """The minimiser without any."""

    def _contradiction(self) -> Candidate | None:
        """The answer if the limits are infeasible; None if they are not."""
        limits = self._problem.limits
        worst = limits.contradiction()
        if worst <= self._request.tolerance * _largest_limit(limits):
            return None
        proof, duals = limits.proof_of_contradiction(), Duals()
        if proof is not None:
            duals = self._problem.duals(None, proof)
        detail = f"limits along a spoke contradict each other by {worst:.2g}"
        return Candidate(None, duals, claim=Claim.INFEASIBLE, detail=detail)


def _largest_limit(limits: SpokeLimits) -> float:
    """The largest finite limit by magnitude; 1 if all are zero."""
    finite = [
        np.abs(values[np.isfinite(values)]).max(initial=0.0)
        for values in (limits.lower, limits.upper, limits.least)
    ]
    return float(max(finite)) or 1.0
