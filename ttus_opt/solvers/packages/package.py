"""Solvers of other packages: names, options and a common base.

Several packages share one front end (qpsolvers, cvxpy), a subclass of `PackageSolver`
of which each of them is an object.
"""

from __future__ import annotations

import abc
import math
import threading
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, TypeVar

from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Candidate, Capabilities, Claim, Request, Solver
from ttus_opt.solvers.sizes import interior_point_seconds
from ttus_opt.solvers.verified import Verified, seconds_left

T = TypeVar("T")

#: Interval at which the main thread checks for an interrupt [s]
PAUSE = 0.1


@dataclass(eq=False, repr=False)
class PackageSolver(Solver):
    """A package's solver, reached through a front end.

    Attributes:
        name: Name to choose it by.
        summary: One line about it.
        module: Import name of the package.
        tolerances: Its options that take the relative tolerance.
        absolute: Options that take a hundredth of it, as absolute tolerances: entries
            here are often far below one.
        time_limit: Its option for a number of seconds; "" for none.
        fixed: Further options with their values.
        least: Least tolerance that it takes [–].
        within: The option that holds all others; "" where they stand alone.
        margin: First tolerance over the requested one: one more iteration is often
            cheaper than a second solve [–].
        pip_name: How to install it; "" for its import name.
        effort: Estimated time over `interior_point_seconds`; infinite to be left out
            of ``solver="auto"`` [–].
    """

    name: str
    summary: str
    module: str
    tolerances: tuple[str, ...] = ()
    absolute: tuple[str, ...] = ()
    time_limit: str = ""
    fixed: Mapping[str, Any] = field(default_factory=dict)
    least: float = 0.0
    within: str = ""
    margin: float = 0.1
    pip_name: str = ""
    effort: float = math.inf

    nonquadratic: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """State what it takes: limits of every kind."""
        self.pip_name = self.pip_name or self.module
        self.capabilities = Capabilities(
            inequalities=True,
            equalities=True,
            nonquadratic=self.nonquadratic,
            time_limit=bool(self.time_limit),
        )

    @property
    def estimates(self) -> bool:
        """Whether there is an estimate."""
        return self.effort < math.inf

    def cost(self, program: Program) -> float:
        """That estimate."""
        if not self.estimates:
            return math.inf
        return self.effort * interior_point_seconds(program)

    def options(self, eps: float, seconds: float | None) -> dict[str, Any]:
        """The package's options for a tolerance and a time limit.

        Args:
            eps: Relative tolerance [–].
            seconds: Time limit; None for none [s].
        """
        eps = max(eps, self.least)
        own: dict[str, Any] = dict.fromkeys(self.tolerances, eps)
        own |= dict.fromkeys(self.absolute, eps * 1e-2) | dict(self.fixed)
        if self.time_limit and seconds is not None:
            own[self.time_limit] = float(seconds)
        return {self.within: own} if self.within else own


class PackageLoaded(Verified):
    """A program in a front end's form; nothing is kept between solves."""

    _backend: PackageSolver

    def __init__(self, solver: PackageSolver, request: Request) -> None:
        self.margin = solver.margin
        super().__init__(solver, request)

    def _attempt(self, eps: float, deadline: float | None) -> Candidate:
        """The package's answer; none where it raises."""
        with warnings.catch_warnings():
            # they concern the package's defaults and status; the answer is checked here
            warnings.simplefilter("ignore")
            try:
                options = self._backend.options(eps, seconds_left(deadline))
                answer = interruptible(lambda: self._solved(options))
            except self._errors() as error:
                message = f"{type(error).__name__}: {error}"
                return Candidate(None, claim=Claim.GAVE_UP, detail=message)
        return self._read(answer)

    @abc.abstractmethod
    def _solved(self, options: Mapping[str, Any]) -> Any:
        """Solve once with the package's options; the front end's result."""

    @abc.abstractmethod
    def _read(self, answer: Any) -> Candidate:
        """The front end's result as a candidate."""

    @abc.abstractmethod
    def _errors(self) -> tuple[type[Exception], ...]:
        """Exceptions of the front end where a package fails."""


def interruptible(work: Callable[[], T]) -> T:
    """Run a function in a thread while the main thread waits for it.

    Python handles an interrupt in the main thread, between two of its own instructions,
    and therefore only after a call into a library has returned. `ttus-opt` runs its
    commands in a process that can be terminated; in notebooks and scripts this helps.
    An interrupt takes effect at once where the library releases Python's lock, as
    Clarabel, HiGHS and SCS do. The work itself cannot be stopped: it finishes in the
    background, and its result is dropped.

    Args:
        work: Called directly where this is not the main thread.

    Returns:
        Its result; its exceptions are raised here.
    """
    if threading.current_thread() is not threading.main_thread():
        return work()
    found: list[T] = []
    raised: list[BaseException] = []

    def run() -> None:
        try:
            found.append(work())
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=run, name="solver", daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(PAUSE)
    if raised:
        raise raised[0]
    return found[0]
