"""A solver of another package: what it is called, and its options in its own words."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from ttus_opt.problem.program import Program


@dataclass(frozen=True)
class Package:
    """A package's solver.

    Attributes:
        name: By which it is asked for here.
        summary: One line about it.
        module: Import name of the package.
        tolerances: Its options that take the tolerance.
        absolute: Those that take a hundredth of it: entries here are often far below
            one.
        time_limit: The one that takes a number of seconds; "" where there is none.
        fixed: Further options with their values.
        least: It takes no smaller tolerance [–].
        within: The option that takes all of these; "" where they stand alone.
        margin: First tolerance handed to it, as a part of the one asked for: an
            iteration more is often cheaper than a second solve [–].
        pip_name: How to install it; "" where that is its import name.
        cost: Estimate for ``solver="auto"`` (`Solver.cost`); None to be left out [s].
    """

    name: str
    summary: str
    module: str
    tolerances: tuple[str, ...]
    absolute: tuple[str, ...] = ()
    time_limit: str = ""
    fixed: Mapping[str, Any] = field(default_factory=dict)
    least: float = 0.0
    within: str = ""
    margin: float = 0.1
    pip_name: str = ""
    cost: Callable[[Program], float] | None = None

    def options(self, eps: float, seconds: float | None) -> dict[str, Any]:
        """A tolerance and a time limit in the package's own words.

        Args:
            eps: Its own relative tolerance [–].
            seconds: Most time it may take; None for no limit [s].
        """
        eps = max(eps, self.least)
        own: dict[str, Any] = dict.fromkeys(self.tolerances, eps)
        own |= dict.fromkeys(self.absolute, eps * 1e-2) | dict(self.fixed)
        if self.time_limit and seconds is not None:
            own[self.time_limit] = float(seconds)
        return {self.within: own} if self.within else own
