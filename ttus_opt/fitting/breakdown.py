"""A solver whose arithmetic breaks down has no answer; the fit itself does not fail.

Badly scaled problems make factorisations fail or iterations diverge. ``solver="auto"``
then continues with the next solver.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from ttus_opt.core.plugins import user_errors
from ttus_opt.problem.locked import locked
from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Candidate, Claim, Prepared, Request, Solver

T = TypeVar("T")

#: Exceptions of arithmetic; from a user's own solver they become an `InputError`
BREAKDOWNS = (ArithmeticError, np.linalg.LinAlgError)


class Guarded(Prepared):
    """A solver with a program loaded, whose breakdowns become candidates without x.

    Args:
        solver: The solver.
        program: The program to load.
        request: Tolerance and time limit.
    """

    def __init__(self, solver: Solver, program: Program, request: Request) -> None:
        """Load the program.

        Raises:
            InputError: The solver cannot take it.
            SolverUnavailableError: The solver's package is not installed.
        """
        self._solver, self._request = solver, request
        self._is_ours = type(solver).__module__.startswith("ttus_opt.")
        self._prepared: Prepared | None = None
        self._why = ""
        self.update(program)

    def update(self, program: Program) -> None:
        """Load other data; after a breakdown, prepare the solver again."""
        kept, self._prepared = self._prepared, None
        self._program = program

        def load() -> Prepared:
            if kept is None:
                return self._solver.prepare(program, self._request)
            kept.update(program)
            return kept

        self._prepared = self._tried(load)

    def solve(self) -> Candidate:
        """The solver's answer, or a candidate with the reason."""
        candidate = None
        if self._prepared is not None:
            candidate = self._tried(self._prepared.solve)
        if candidate is None:
            return Candidate(None, claim=Claim.GAVE_UP, detail=self._why)
        return candidate

    def _tried(self, act: Callable[[], T]) -> T | None:
        """The result of a call; None if it broke down."""
        try:
            with contextlib.ExitStack() as stack:
                stack.enter_context(user_errors(f"solver {self._solver.name}"))
                if not self._is_ours:
                    stack.enter_context(locked(self._program))
                return act()
        except BREAKDOWNS as error:
            self._why = f"{type(error).__name__}: {error}"
            return None
