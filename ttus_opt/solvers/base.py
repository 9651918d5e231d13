"""What a solver is: ``prepare(program)`` once, then ``update(program)``, ``solve()``.

A solver answers with a `Candidate`; whether it is a solution is decided elsewhere
(`ttus_opt.fitting.batch`) by residuals computed there.
"""

from __future__ import annotations

import abc
import enum
import importlib.util
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.errors import InputError, SolverUnavailableError
from ttus_opt.problem.kkt import Duals
from ttus_opt.problem.program import Program


class Claim(enum.Enum):
    """What a solver says of its own run."""

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
        x: All variables, shape (n,); None when there is none.
        duals: Multipliers, signs as in `ttus_opt.problem.kkt`.
        iterations: Of the main loop [–].
        claim: What the solver says of its run.
        detail: In its own words.
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
        nonquadratic: Penalties that are no sum of squares.
        keeps: What a new solve with other data reuses, in words; empty for nothing.
        time_limit: Whether it stops by itself when the time is up.
    """

    inequalities: bool
    equalities: bool
    any_terms: bool = True
    nonquadratic: bool = False
    keeps: str = ""
    time_limit: bool = True


@dataclass(frozen=True)
class Request:
    """What is asked of a solve.

    Attributes:
        tolerance: Largest relative KKT residual [–].
        time_limit: Most seconds to spend; None for no limit [s].
        told: Called with the relative KKT residual of every better answer on the way,
            by solvers that check them [–].
    """

    tolerance: float = 1e-6
    time_limit: float | None = None
    told: Callable[[float], None] | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        """Validate tolerance and time limit.

        Raises:
            InputError: A tolerance or limit that is not positive.
        """
        if not 0.0 < self.tolerance < 1.0:
            raise InputError(
                f"tolerance must lie between 0 and 1, got {self.tolerance}"
            )
        if self.time_limit is not None and not self.time_limit > 0.0:
            raise InputError(f"time_limit must be positive [s], got {self.time_limit}")


class Prepared(abc.ABC):
    """A solver with a program loaded."""

    @abc.abstractmethod
    def update(self, program: Program) -> None:
        """Take a program of the same structure with other data."""

    @abc.abstractmethod
    def solve(self) -> Candidate:
        """Solve what is loaded."""

    def start_at(self, x: Array, duals: Duals) -> None:
        """Begin the next solve at a point near its answer; here of no use.

        Args:
            x: All variables, shape (n,).
            duals: Multipliers there, signs as in `ttus_opt.problem.kkt`.
        """
        del x, duals


class Solver(abc.ABC):
    """A backend.

    Attributes:
        name: By which it is asked for.
        summary: One line about it.
        capabilities: What it can take.
        module: Import name of what it needs beyond this package's own; "" for none.
        pip_name: How to install that.
    """

    name: str
    summary: str
    capabilities: Capabilities
    module: str = ""
    pip_name: str = ""

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
            return "a penalty is no sum of squares, or there are cones"
        if program.bounds and not can.inequalities:
            return "it takes no bounds"
        for constraint in program.constraints:
            equal = bool(np.array_equal(constraint.lower, constraint.upper))
            if not (can.equalities if equal else can.inequalities):
                return f"it takes no constraint {constraint.name}"
        return ""

    @property
    def estimates(self) -> bool:
        """Whether "auto" considers it: whether it has a `cost` of its own."""
        return type(self).cost is not Solver.cost

    def cost(self, program: Program) -> float:
        """About how many seconds set-up and first solve take; "auto" takes the least.

        It has to be quick and needs sizes only (`ttus_opt.solvers.sizes`).

        Args:
            program: One that it takes, reduced and compressed.

        Returns:
            Seconds of one core; infinite where "auto" shall leave it out [s].
        """
        return math.inf

    def require(self, program: Program) -> None:
        """Check that the solver is there and can take a program.

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

    @abc.abstractmethod
    def prepare(self, program: Program, request: Request) -> Prepared:
        """Load a program: factorise, scale, allocate."""
