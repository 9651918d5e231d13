"""Conjugate gradients on the normal equations and the multipliers of the few rows.

With multipliers y of the few rows, minus half the gradient of F at p is r + Dᵀs with

    r = Σ w Mᵀ(t - M p) + Dᵀy,    s = (t - D p) - y.

A step changes p and y together. A constraint preconditioner keeps s = 0 once it holds,
so that heavy rows cancel exactly, before rounding, at any weight (Gould, Hribar and
Nocedal, SIAM J. Sci. Comput. 23, 2001). Every round therefore begins with a full step.
Residuals are computed from the factors M and D, never from MᵀM. The preconditioner may
vary slightly from step to step; directions follow Polak and Ribière's rule (flexible
conjugate gradients: Notay, SIAM J. Sci. Comput. 22, 2000).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.solvers.dual.options import Accuracy


@dataclass(frozen=True)
class Pair:
    """A field and the multipliers of the few rows, or a residual of both.

    Attributes:
        p: Shape (V,).
        y: Shape (m,).
    """

    p: Array = field(repr=False)
    y: Array = field(repr=False)

    def plus(self, factor: float, other: Pair) -> Pair:
        """This one plus a multiple of another."""
        return Pair(self.p + factor * other.p, self.y + factor * other.y)


class Quadratic(Protocol):
    """A strictly convex quadratic function F of a field, with few rows D in it."""

    def residual(self, at: Pair) -> Pair:
        """(r, s) of the module's docstring."""

    def image(self, along: Pair) -> tuple[Pair, Array]:
        """Decrease of (r, s) along a direction, and D times the direction's field."""

    def measure(self, p: Array) -> Array:
        """D p, shape (m,)."""

    def gradient(self, rest: Pair) -> Array:
        """Minus half the gradient, r + Dᵀs, shape (V,)."""

    def value(self, p: Array) -> float:
        """F(p)."""


class Preconditioner(Protocol):
    """Approximate inverse of `Quadratic.image`."""

    def apply(self, rest: Pair) -> Pair:
        """A step in p and y."""


@dataclass(frozen=True)
class Goal:
    """When to stop.

    Attributes:
        gap: Estimated gap over F, relative [–].
        least_gap: Absolute gap that always suffices.
        gradient: Norm of half the gradient.
        max_steps: Most steps [–].
        accuracy: Its deadline.
    """

    gap: float
    least_gap: float
    gradient: float
    max_steps: int
    accuracy: Accuracy

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
        at: The field and the multipliers.
        steps: Steps taken [–].
        reached: Whether the goal was reached.
    """

    at: Pair
    steps: int
    reached: bool


def inner_product(a: Array, b: Array) -> float:
    """Σ a b on one core; a threaded BLAS is slower while the cores are busy."""
    return float(np.einsum("i,i", a, b))


def minimise(
    function: Quadratic,
    preconditioner: Preconditioner,
    at: Pair,
    goal: Goal,
    rounds: int,
    gain: float,
) -> Minimum:
    """Minimise a quadratic function.

    Args:
        function: The function.
        preconditioner: Its preconditioner.
        at: Where to start.
        goal: When to stop.
        rounds: Most rounds, each from a recomputed residual [–].
        gain: Stop when a round leaves more than this part of the gap [–].
    """
    steps, before = 0, np.inf
    for _ in range(rounds):
        rest = function.residual(at)
        step = preconditioner.apply(rest)
        gap, value = _slope(function, rest, step), function.value(at.p)
        if goal.reached(gap, value, function.gradient(rest)):
            return Minimum(at, steps, True)
        if not gap < gain * before or steps >= goal.max_steps or goal.accuracy.late:
            break
        at, taken, before = at.plus(1.0, step), 0, gap
        at, taken = _steps(function, preconditioner, at, goal, goal.max_steps - steps)
        steps += taken + 1
    return Minimum(at, steps, False)


def _slope(function: Quadratic, rest: Pair, step: Pair) -> float:
    """Minus half the slope of F along a step; for a full Newton step, the gap."""
    along_rows = inner_product(rest.y, function.measure(step.p))
    return inner_product(rest.p, step.p) + along_rows


def _steps(
    function: Quadratic,
    preconditioner: Preconditioner,
    at: Pair,
    goal: Goal,
    most: int,
) -> tuple[Pair, int]:
    """Iterate until the recurred residual and gap reach the goal."""
    rest, value, steps = function.residual(at), function.value(at.p), 0
    direction = preconditioner.apply(rest)
    gap = _slope(function, rest, direction)
    while not goal.reached(gap, value, function.gradient(rest)):
        image, measured = function.image(direction)
        # dᵀH d, with H d = image.p + Dᵀ image.y
        curvature = inner_product(direction.p, image.p) + float(measured @ image.y)
        if not (curvature > 0.0 and gap > 0.0) or steps == most or goal.accuracy.late:
            break
        slope = _slope(function, rest, direction)
        alpha = slope / curvature
        at, rest = at.plus(alpha, direction), rest.plus(-alpha, image)
        value, steps = value - alpha * slope, steps + 1
        step = preconditioner.apply(rest)
        before, gap = gap, _slope(function, rest, step)
        drop = alpha * _slope(function, image, step)
        direction = step.plus(max(-drop / before, 0.0), direction)
    return at, steps
