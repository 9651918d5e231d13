"""A tolerance with the same meaning for every backend: solve, check, tighten.

Packages stop by residuals of their own scaling; a request is about the relative KKT
residual of the original program (`problem.verify.kkt`). So the answer of a first
attempt is checked; where it falls short, the package's tolerance is tightened by the
missing factor and the solve repeated, a few times and within the time limit. A backend
that keeps its iterate is checked at intervals: where rounding keeps it from its own
criterion, the KKT residual often holds already.
"""

from __future__ import annotations

import abc
import time
from dataclasses import replace
from typing import Any

import numpy as np

from ttus_opt.problem.program import Program
from ttus_opt.problem.reduction import Reduction
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers.base import Candidate, Claim, Prepared, Request, is_late

#: Least and largest tightening between attempts
LEAST, MOST = 0.1, 1e-3


def seconds_left(deadline: float | None) -> float | None:
    """Time until a deadline, a `time.perf_counter`; None for none [s].

    At least a microsecond: packages refuse a negative limit, and take 0 for none.
    """
    return None if deadline is None else max(deadline - time.perf_counter(), 1e-6)


class Verified(Prepared):
    """A backend whose answer is checked and whose tolerance is tightened."""

    #: First tolerance of the package over the requested one
    margin: float = 1.0
    #: Least tolerance of the package, set by rounding
    floor: float = 1e-14
    #: Most continuations from the last iterate; 0 when none is kept
    continuations: int = 0
    #: Most times the tolerance is tightened, and the range of the factor
    tightenings: int = 4
    tightening: tuple[float, float] = (MOST, LEAST)
    #: Claims after which it is
    tightened_after: tuple[Claim, ...] = (Claim.DONE,)
    #: Whether an answer no better than the last one may be followed by another
    patient: bool = True

    def __init__(self, solver: Any, request: Request) -> None:
        super().__init__(solver, request)
        self._eps = max(request.tolerance * self.margin, self.floor)

    def update(self, program: Program) -> None:
        """Take other data."""
        self._program = program
        self._load(program)

    @abc.abstractmethod
    def _load(self, program: Program) -> None:
        """Bring the program into the package's form."""

    @abc.abstractmethod
    def _attempt(self, eps: float, deadline: float | None) -> Candidate:
        """Solve once, to the package's tolerance and until a deadline."""

    def solve(self) -> Candidate:
        """Solve, check and tighten; return the best answer."""
        deadline, tolerance = self._request.deadline(), self._request.tolerance
        best, least = Candidate(None, claim=Claim.TIME_LIMIT, detail="no time"), np.inf
        tightened = continued = iterations = 0
        while not is_late(deadline):
            candidate = self._attempt(self._eps, deadline)
            iterations += candidate.iterations
            residual = self._residual(candidate)
            gained = residual < least
            if gained or best.x is None:
                best, least = candidate, residual
                self._request.tell(residual)
            if residual <= tolerance or candidate.x is None:
                break
            if candidate.claim in self.tightened_after:
                tightened += 1
                if tightened > self.tightenings or self._eps <= self.floor:
                    break
                if not (gained or self.patient):
                    break
                missing = float(np.clip(tolerance / residual, *self.tightening))
                self._eps = max(self._eps * missing, self.floor)
            elif candidate.claim is Claim.PAUSED and continued < self.continuations:
                continued += 1
            else:
                break
        late = least > tolerance and is_late(deadline)
        claim = Claim.TIME_LIMIT if late else best.claim
        return replace(best, iterations=iterations, claim=claim)

    def _residual(self, candidate: Candidate) -> float:
        if candidate.x is None:
            return np.inf
        # the verdict is on the declared program
        declared = self._program.declared or self._program
        point = Reduction(declared, self._program).restore(candidate.x, candidate.duals)
        kkt = kkt_residuals(
            declared, point.x, point.duals, tolerance=self._request.tolerance
        )
        return kkt.worst_relative
