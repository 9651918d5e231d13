"""A solver whose arithmetic breaks down gives no answer: no error of the fit.

Numbers of very different size in one problem end in a factorisation that fails or an
iteration that does not settle. ``solver="auto"`` then goes on to the next solver.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Candidate, Claim, Prepared, Request, Solver
from ttus_opt.user_code import told_by_line

T = TypeVar("T")

#: What arithmetic raises; of a user's own solver it is told with its line
BREAKDOWNS = (ArithmeticError, np.linalg.LinAlgError)


class Guarded(Prepared):
    """A solver with a program loaded, whose breakdowns are answers without a point.

    Args:
        solver: The solver.
        program: What it is to load.
        request: Tolerance and time limit.
    """

    def __init__(self, solver: Solver, program: Program, request: Request) -> None:
        """Load the program.

        Raises:
            InputError: The solver cannot take it.
            SolverUnavailableError: The solver's package is not installed.
        """
        self._solver, self._request = solver, request
        self._prepared: Prepared | None = None
        self._why = ""
        self.update(program)

    def update(self, program: Program) -> None:
        """Take other data; all anew after a breakdown."""
        kept, self._prepared = self._prepared, None

        def load() -> Prepared:
            if kept is None:
                return self._solver.prepare(program, self._request)
            kept.update(program)
            return kept

        self._prepared = self._tried(load)

    def solve(self) -> Candidate:
        """The solver's answer, or none and why."""
        found = None
        if self._prepared is not None:
            found = self._tried(self._prepared.solve)
        if found is None:
            return Candidate(None, claim=Claim.GAVE_UP, detail=self._why)
        return found

    def _tried(self, act: Callable[[], T]) -> T | None:
        """What it returns; None where it broke down."""
        try:
            with told_by_line(f"solver {self._solver.name}"):
                return act()
        except BREAKDOWNS as error:
            self._why = f"{type(error).__name__}: {error}"
            return None
