"""A solver whose arithmetic breaks down has no answer; the fit itself does not fail.

Badly scaled problems make factorisations fail or iterations diverge. ``solver="auto"``
then continues with the next solver. A user's solver cannot write to the program's
arrays, which are those of the scene and of the verdict after the solve.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.core.plugins import user_errors
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


@contextlib.contextmanager
def locked(thing: Any) -> Iterator[None]:
    """Make all arrays of a dataclass, in members too, read-only within the block."""
    arrays: dict[int, Array] = {}
    _collect(thing, arrays, set())
    written = [array for array in arrays.values() if array.flags.writeable]
    try:
        for array in written:
            array.flags.writeable = False
        yield
    finally:
        for array in reversed(written):
            array.flags.writeable = True


def _collect(thing: Any, arrays: dict[int, Array], seen: set[int]) -> None:
    """Arrays of a thing, of its fields and of what it has cached."""
    if isinstance(thing, np.ndarray):
        arrays[id(thing)] = thing
    elif sp.issparse(thing):
        parts: list[Any] = [vars(thing).get(k) for k in ("data", "indices", "indptr")]
        for part in (*parts, *(vars(thing).get("coords") or ())):
            _collect(part, arrays, seen)
    elif id(thing) not in seen:
        seen.add(id(thing))
        if dataclasses.is_dataclass(thing):
            thing = tuple(vars(thing).values())
        elif isinstance(thing, Mapping):
            thing = tuple(thing.values())
        if isinstance(thing, tuple | list | frozenset):
            for part in thing:
                _collect(part, arrays, seen)
