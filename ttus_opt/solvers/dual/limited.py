"""A loaded program with limits: its working sets, infeasibility."""

from __future__ import annotations

import abc
from collections.abc import Mapping

import numpy as np

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.laplace.system import RTOL
from ttus_opt.problem.verify.kkt import Duals
from ttus_opt.solvers.base import Candidate, Claim
from ttus_opt.solvers.dual.active_set import (
    DUAL_MARGIN,
    ActiveSetIteration,
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
    _limits: SpokeLimits
    _last: tuple[Array, WorkingSet] | None = None

    def _begin(
        self,
        p: Array,
        bounds: Array | None,
        links: Mapping[str, IntArray],
        duals: Duals,
    ) -> None:
        """Start from the working set of the limits that have multipliers.

        Args:
            p: The field in the limits' units, shape (V,).
            bounds: Multipliers of its bounds, positive at upper ones; None for none.
            links: By constraint name, the voxels of its links.
            duals: Has the multipliers of these.
        """
        active = WorkingSet.empty(len(p))
        if bounds is not None:
            active.bounds[:] = np.sign(bounds)
        for name, at in links.items():
            if name in duals.rows:
                active.links[at] |= duals.rows[name] != 0.0
        self._last = p, active

    def solve(self) -> Candidate:
        """Solve working sets; a program without limits as it is."""
        self._eps = max(self._request.tolerance * self.margin, RTOL)
        contradiction = self._contradiction() if self._limits.binding else None
        return contradiction or super().solve()

    def _attempt(self, eps: float, deadline: float | None) -> Candidate:
        accuracy = Accuracy(eps, deadline=deadline)
        return (self._limited if self._limits.binding else self._unlimited)(accuracy)

    @abc.abstractmethod
    def _limited(self, accuracy: Accuracy) -> Candidate:
        """The minimiser within the limits."""

    def _unlimited(self, accuracy: Accuracy) -> Candidate:
        """The minimiser without any."""
        return self._limited(accuracy)

    def _contradiction(self) -> Candidate | None:
        """The answer if the limits are infeasible; None if they are not."""
        limits = self._limits
        worst = limits.contradiction()
        if worst <= self._request.tolerance * _largest_limit(limits):
            return None
        detail = f"limits along a spoke contradict each other by {worst:.2g}"
        return Candidate(None, self._proof(), claim=Claim.INFEASIBLE, detail=detail)

    def _proof(self) -> Duals:
        """Multipliers that prove infeasibility; empty if they are not known."""
        return self._limits.proof_of_contradiction() or Duals()

    def _within(
        self, problem: LimitedProblem, accuracy: Accuracy
    ) -> ActiveSetIteration:
        """The minimiser with limits, started from the last working set."""
        answer = primal_dual_active_set(
            problem, self._last, self._request.tolerance, accuracy
        )
        if answer.settled:
            self._last = answer.p, answer.active
        return answer


def candidate_of(answer: ActiveSetIteration, x: Array, duals: Duals) -> Candidate:
    """The end of an iteration as a solver's answer."""
    claim = Claim.TIME_LIMIT if answer.late else Claim.GAVE_UP
    return Candidate(
        x,
        duals,
        answer.steps,
        Claim.DONE if answer.settled else claim,
        f"{answer.sets} working sets, {answer.active.count} active limits",
    )


def _largest_limit(limits: SpokeLimits) -> float:
    """The largest finite limit by magnitude; 1 if all are zero."""
    finite = [
        np.abs(values[np.isfinite(values)]).max(initial=0.0)
        for values in (limits.lower, limits.upper, limits.least)
    ]
    return float(max(finite)) or 1.0
