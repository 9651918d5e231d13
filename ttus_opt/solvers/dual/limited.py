"""A loaded program with limits: repeated solves of higher accuracy, infeasibility."""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.laplace.system import RTOL
from ttus_opt.problem.program import Program
from ttus_opt.problem.verify.kkt import Duals, kkt_residuals
from ttus_opt.solvers.base import Candidate, Claim, Prepared, Request
from ttus_opt.solvers.dual.active_set import (
    DUAL_MARGIN,
    ActiveSetIteration,
    LimitedProblem,
    primal_dual_active_set,
)
from ttus_opt.solvers.dual.limits import SpokeLimits
from ttus_opt.solvers.dual.solver import Accuracy
from ttus_opt.solvers.dual.working_set import WorkingSet

#: Most attempts until the KKT residuals hold, each with a residual smaller by a factor:
#: the dual's residual is relative to the measurements, the tolerance to what is left
#: where these nearly cancel [–]
TIGHTENINGS, TIGHTENING = 4, 1e-3


class Limited(Prepared):
    """A program with its last working set and the request to the solver."""

    _program: Program
    _limits: SpokeLimits

    def __init__(self, program: Program, request: Request) -> None:
        """Load a program."""
        self._request = request
        self._last: tuple[Array, WorkingSet] | None = None
        self.update(program)

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
        if not self._limits.binding:
            return self._tightened(self._unlimited)
        return self._contradiction() or self._tightened(self._limited)

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

    def _tightened(self, attempt: Callable[[Accuracy], Candidate]) -> Candidate:
        """Solve with increasing accuracy until the KKT residuals hold; the best answer.

        Args:
            attempt: Solves to a given accuracy of the dual.
        """
        deadline = self._request.deadline()
        rtol = max(self._request.tolerance * DUAL_MARGIN, RTOL)
        steps, best, least = 0, Candidate(None), np.inf
        for _ in range(TIGHTENINGS):
            candidate = attempt(Accuracy(rtol, deadline=deadline))
            assert candidate.x is not None
            steps += candidate.iterations
            kkt = kkt_residuals(
                self._program,
                candidate.x,
                candidate.duals,
                tolerance=self._request.tolerance,
            )
            gained = kkt.worst_relative < least
            if gained or best.x is None:
                best, least = candidate, kkt.worst_relative
            if least <= self._request.tolerance or not gained:
                break
            if candidate.claim is Claim.TIME_LIMIT:
                break
            rtol *= TIGHTENING
        return replace(best, iterations=steps)

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
