"""A tolerance that means the same for every backend: solve, check, tighten.

Every package measures its own residuals, of its own scaling of the problem. What is
asked of us is a relative KKT residual of the original program
(`ttus_opt.problem.kkt`): the first attempt uses a translation of it, its answer is
checked, and where it falls short the package's own tolerance is tightened by what
was missing and the solve repeated, a few times and within the time limit. A backend
that keeps its iterate is stopped every so often and checked on the way: where its own
criterion cannot be met for rounding, ours often is.
"""

from __future__ import annotations

import abc
import time
from dataclasses import replace

import numpy as np

from ttus_opt.problem.kkt import kkt_residuals
from ttus_opt.problem.program import Program
from ttus_opt.problem.reduction import Reduction
from ttus_opt.solvers.base import Candidate, Claim, Prepared, Request

#: Most times the tolerance is tightened
TIGHTENINGS = 4

#: Each attempt tightens by what was missing, at least and at most by these
LEAST, MOST = 0.1, 1e-3


class Verified(Prepared):
    """A backend whose answer is checked and whose tolerance is tightened.

    A backend says how it loads a program and how it tries once.
    """

    #: First tolerance handed to the package, as a part of the one asked for
    margin: float = 1.0
    #: The package is not asked for less: rounding ends there
    floor: float = 1e-14
    #: How many times it may go on from where it stopped; 0 when it keeps no iterate
    continuations: int = 0

    def __init__(self, program: Program, request: Request) -> None:
        self._request = request
        self._eps = max(request.tolerance * self.margin, self.floor)
        self.update(program)

    def update(self, program: Program) -> None:
        """Take other data."""
        self._program = program
        self._load(program)

    @abc.abstractmethod
    def _load(self, program: Program) -> None:
        """Bring the program into the package's form."""

    @abc.abstractmethod
    def _attempt(self, eps: float, seconds: float | None) -> Candidate:
        """Solve once to the package's own tolerance within a time."""

    def solve(self) -> Candidate:
        """Solve, check and tighten; the best answer found."""
        clock = time.perf_counter()
        limit = self._request.time_limit
        best, least = Candidate(None, claim=Claim.TIME_LIMIT, detail="no time"), np.inf
        tightened = continued = iterations = 0
        while True:
            left = None
            if limit is not None:
                left = limit - (time.perf_counter() - clock)
                if left <= 0.0:
                    break
            candidate = self._attempt(self._eps, left)
            iterations += candidate.iterations
            residual = self._residual(candidate)
            if best.x is None or residual < least:
                best, least = candidate, residual
                if self._request.told is not None and np.isfinite(residual):
                    self._request.told(residual)
            if residual <= self._request.tolerance or candidate.x is None:
                break
            if candidate.claim is Claim.DONE:
                tightened += 1
                if tightened > TIGHTENINGS or self._eps <= self.floor:
                    break
                missing = float(
                    np.clip(self._request.tolerance / residual, MOST, LEAST)
                )
                self._eps = max(self._eps * missing, self.floor)
            elif candidate.claim is Claim.PAUSED and continued < self.continuations:
                continued += 1
            else:
                break
        return replace(
            best, iterations=iterations, claim=self._final_claim(best, least, clock)
        )

    def _residual(self, candidate: Candidate) -> float:
        if candidate.x is None:
            return np.inf
        # of what was declared, by which the answer is judged
        declared = self._program.declared or self._program
        point = Reduction(declared, self._program).restore(candidate.x, candidate.duals)
        kkt = kkt_residuals(
            declared, point.x, point.duals, tolerance=self._request.tolerance
        )
        return kkt.worst_relative

    def _final_claim(self, best: Candidate, residual: float, clock: float) -> Claim:
        """The package's claim, unless time ran out before the check held."""
        if residual <= self._request.tolerance:
            return best.claim
        limit = self._request.time_limit
        if limit is not None and time.perf_counter() - clock >= limit:
            return Claim.TIME_LIMIT
        return best.claim
