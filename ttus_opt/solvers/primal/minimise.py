"""Rounds of conjugate gradients over a field and the multipliers of its few rows.

With multipliers y of the few rows, minus half the gradient of F at p is r + Dᵀs with

    r = Σ w Mᵀ(t - M p) + Dᵀy,    s = (t - D p) - y.

A step changes p and y together; a point, a step and a residual are vectors (p, y),
(z, y) and (r, s) of V + m entries. A constraint preconditioner keeps s = 0 once it
holds, so that heavy rows cancel exactly, before rounding, at any weight (Gould, Hribar
and Nocedal, SIAM J. Sci. Comput. 23, 2001). Every round therefore begins with a full
step. Residuals are computed from the factors M and D, never from MᵀM.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol

from ttus_opt.core.arrays import Array
from ttus_opt.solvers.conjugate_gradients import (
    LastDirection,
    conjugate_gradients,
    inner_product,
)
from ttus_opt.solvers.dual.options import Accuracy

#: A run ends where a round leaves more than this part of the gap [–]
GAIN = 0.5


class Quadratic(Protocol):
    """A strictly convex quadratic function F of a field, with few rows D in it."""

    def residual(self, at: Array) -> Array:
        """(r, s) of the module's docstring."""

    def image(self, along: Array) -> Array:
        """Decrease of (r, s) along a direction."""

    def pairing(self, rest: Array, along: Array) -> float:
        """(r + Dᵀs)ᵀz, minus half the slope of F along a direction (z, y)."""

    def gradient(self, rest: Array) -> Array:
        """Minus half the gradient, r + Dᵀs, shape (V,)."""

    def value(self, at: Array) -> float:
        """F(p)."""


@dataclass(frozen=True)
class Goal:
    """When to stop.

    Attributes:
        gap: Estimated gap over F, relative [–].
        least_gap: Absolute gap that always suffices.
        gradient: Norm of half the gradient.
        accuracy: Its deadline.
        max_steps: Most steps [–].
    """

    gap: float
    least_gap: float
    gradient: float
    accuracy: Accuracy
    max_steps: int = 300

    def times(self, factor: float) -> Goal:
        """The same with both gaps multiplied by a factor."""
        least = self.least_gap * factor
        return replace(self, gap=self.gap * factor, least_gap=least)

    def reached(self, gap: float, value: float, gradient: Array) -> bool:
        """Whether an estimate of the gap and a gradient are small enough."""
        if gap > max(self.gap * value, self.least_gap):
            return False
        return bool(inner_product(gradient, gradient) <= self.gradient**2)


@dataclass(frozen=True)
class Minimum:
    """Result of `minimise`.

    Attributes:
        at: The field and the multipliers, shape (V + m,).
        steps: Steps taken [–].
        reached: Whether the goal was reached.
    """

    at: Array = field(repr=False)
    steps: int
    reached: bool


def minimise(
    function: Quadratic,
    preconditioner: Callable[[Array], Array],
    at: Array,
    goal: Goal,
    rounds: int = 8,
) -> Minimum:
    """Minimise a quadratic function.

    Args:
        function: The function.
        preconditioner: From (r, s) to a step (z, y).
        at: Where to start, shape (V + m,).
        goal: When to stop.
        rounds: Most rounds, each from a recomputed residual [–].
    """
    steps, before = 0, float("inf")
    now = 0.0  # F along a run

    def late(y: Array, left: Array) -> bool:
        nonlocal now
        now = value - function.pairing(rest + left, y)
        return goal.accuracy.late

    def step(left: Array) -> Array | None:
        """The next step; None where the estimated gap is small enough."""
        found = preconditioner(left)
        gap = function.pairing(left, found)
        enough = not gap > 0.0 or goal.reached(gap, now, function.gradient(left))
        return None if enough else found

    for _ in range(rounds):
        rest = function.residual(at)
        full = preconditioner(rest)
        gap, value = function.pairing(rest, full), function.value(at)
        if goal.reached(gap, value, function.gradient(rest)):
            return Minimum(at, steps, True)
        if not gap < GAIN * before or steps >= goal.max_steps or goal.accuracy.late:
            break
        at, before = at + full, gap
        rest, value = function.residual(at), function.value(at)
        run = conjugate_gradients(
            LastDirection(function.image, function.pairing),
            rest,
            step,
            late,
            goal.max_steps - steps,
        )
        at, steps = at + run.y, steps + run.steps + 1
    return Minimum(at, steps, False)
