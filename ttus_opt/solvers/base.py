"""The interface of solvers: ``prepare(program)`` once, then ``update``, ``solve``.

A solver answers with a `Candidate`; `ttus_opt.fitting.verdict` decides by its own
residuals whether that is a solution.
"""

from __future__ import annotations

import abc
import enum
import importlib.util
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError, SolverUnavailableError
from ttus_opt.problem.program import Program
from ttus_opt.problem.verify.kkt import Duals

#: Least relative KKT residual that can be asked for: sums of many numbers in double
#: precision are not more accurate [–]
LEAST_TOLERANCE = 1e-14


def is_late(deadline: float | None) -> bool:
    """Whether a deadline, a `time.perf_counter` or None for never, has passed [s]."""
    return deadline is not None and time.perf_counter() > deadline


class Claim(enum.Enum):
    """A solver's own statement about its run."""

    DONE = "done"
    PAUSED = "stopped at the number of iterations it was given, could go on"
    DOUBTS = "says itself that its answer may be inaccurate"
    INFEASIBLE = "infeasible"
    UNBOUNDED = "unbounded"
    TIME_LIMIT = "time limit"
    GAVE_UP = "gave up"


@dataclass(frozen=True)
class Candidate:
    """An answer not yet verified.

    Attributes:
        x: All variables, shape (n,); None without an answer.
        duals: Multipliers, signs as in `ttus_opt.problem.verify.kkt`.
        iterations: Iterations of the main loop [–].
        claim: The solver's statement about its run.
        detail: The same in its own words.
    """

    x: Array | None
    duals: Duals = field(default_factory=Duals)
    iterations: int = 0
    claim: Claim = Claim.DONE
    detail: str = ""


@dataclass(frozen=True)
class Capabilities:
    """What a solver can take.

    Attributes:
        inequalities: Bounds and inequality rows.
        equalities: Equality rows.
        any_terms: Terms other than Laplace and measured rows.
        nonquadratic: Penalties other than sums of squares.
        keeps: What a solve with other data reuses, in words; empty for nothing.
        time_limit: Whether it keeps a time limit.
    """

    inequalities: bool
    equalities: bool
    any_terms: bool = True
    nonquadratic: bool = False
    keeps: str = ""
    time_limit: bool = True


@dataclass(frozen=True)
class Request:
    """What a solve has to reach.

    Attributes:
        tolerance: Largest relative KKT residual [–].
        time_limit: Most seconds to spend; None for no limit [s].
        told: Callback with the relative KKT residual [–] of every better iterate, for
            solvers that compute it.
    """

    tolerance: float = 1e-6
    time_limit: float | None = None
    told: Callable[[float], None] | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        """Validate tolerance and time limit.

        Raises:
            InputError: A tolerance or limit that is not positive.
        """
        if not LEAST_TOLERANCE <= self.tolerance < 1.0:
            raise InputError(
                f"tolerance must lie between {LEAST_TOLERANCE:g}, what double "
                f"precision gives, and 1, got {self.tolerance}"
            )
        if self.time_limit is not None and not self.time_limit > 0.0:
            raise InputError(f"time_limit must be positive [s], got {self.time_limit}")

    def deadline(self) -> float | None:
        """`time.perf_counter` at the end of a solve begun now; None for none [s]."""
        limit = self.time_limit
        return None if limit is None else time.perf_counter() + limit

    def tell(self, residual: float) -> None:
        """Pass on the relative KKT residual [–] of a better iterate."""
        if self.told is not None and math.isfinite(residual):
            self.told(residual)


class Prepared(abc.ABC):
    """A solver with a program loaded, by `update` first.

    Args:
        solver: The solver.
        request: What a solve has to reach.
    """

    def __init__(self, solver: Any, request: Request) -> None:
        self._backend, self._request = solver, request

    @abc.abstractmethod
    def update(self, program: Program) -> None:
        """Take a program; any after the first has the structure of the first."""

    @abc.abstractmethod
    def solve(self) -> Candidate:
        """Solve the loaded program."""

    def start_at(self, x: Array, duals: Duals) -> None:
        """Warm-start the next solve; ignored by default.

        Args:
            x: All variables, shape (n,).
            duals: Multipliers there, signs as in `ttus_opt.problem.verify.kkt`.
        """
        del x, duals


class Solver:
    """A backend.

    Attributes:
        name: Name to choose it by.
        summary: One line about it.
        capabilities: What it can take.
        module: Import name of the optional package it needs; "" for none.
        pip_name: How to install that package.
        loaded: What it is with a program loaded, where it does not override `prepare`.
    """

    name: str
    summary: str
    capabilities: Capabilities
    module: str = ""
    pip_name: str = ""
    loaded: type[Prepared]

    def __repr__(self) -> str:
        return f"<solver {self.name}: {self.summary}>"

    @property
    def installed(self) -> bool:
        """Whether its package can be found."""
        return not self.module or importlib.util.find_spec(self.module) is not None

    def refusal(self, program: Program) -> str:
        """Why it cannot take a program, in words; empty when it can."""
        can = self.capabilities
        if not (can.nonquadratic or program.is_quadratic):
            return "a penalty is not a sum of squares, or there are cones"
        if program.bounds and not can.inequalities:
            return "it takes no bounds"
        for constraint in program.constraints:
            equal = bool(np.array_equal(constraint.lower, constraint.upper))
            if not (can.equalities if equal else can.inequalities):
                return f"it takes no constraint {constraint.name}"
        return ""

    def excess(self, program: Program) -> str:
        """Why a program is too large for it, which others would take hours for.

        Then "auto" says so instead of taking another; empty when it is not.
        """
        return ""

    @property
    def estimates(self) -> bool:
        """Whether "auto" considers it: whether it overrides `cost`."""
        return type(self).cost is not Solver.cost

    def cost(self, program: Program) -> float:
        """Estimated time of set-up and first solve; "auto" takes the least.

        It must be quick, from sizes alone (`ttus_opt.solvers.sizes`).

        Args:
            program: A program that it takes, reduced and compressed.

        Returns:
            Time on one core; infinite to be left out of "auto" [s].
        """
        return math.inf

    def require(self, program: Program) -> None:
        """Check that the solver is installed and can take a program.

        Raises:
            SolverUnavailableError: Its package is not installed.
            InputError: It cannot take this program.
        """
        if not self.installed:
            raise SolverUnavailableError(
                f"solver {self.name} is not installed: pip install {self.pip_name}"
            )
        why = self.refusal(program)
        if why:
            raise InputError(
                f"solver {self.name} cannot take this problem: {why}: choose another "
                'or solver="auto"'
            )

    def prepare(self, program: Program, request: Request) -> Prepared:
        """Load a program: factorise, scale, allocate.

        Raises:
            InputError: It cannot take this program.
            SolverUnavailableError: Its package is not installed.
        """
        self.require(program)
        if not hasattr(self, "loaded"):
            raise InputError(
                f"solver {self.name} has neither `loaded`, a Prepared with update and "
                "solve, nor a prepare of its own"
            )
        prepared = self.loaded(self, request)
        prepared.update(program)
        return prepared
