"""The objective as a function of the field alone, minimised with its preconditioner.

"Across the columns of c" means projected so that the unknowns c beside the field are
eliminated (`ttus_opt.solvers.dual.linear_parameters.Complement`).

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

import numpy as np

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.solvers.conjugate_gradients import (
    LastDirection,
    conjugate_gradients,
    inner_product,
)
from ttus_opt.solvers.dual.linear_parameters import Complement
from ttus_opt.solvers.dual.solver import Accuracy
from ttus_opt.solvers.primal.approximate_system import ApproximateSystem
from ttus_opt.solvers.primal.preconditioner import INNER, ConstraintPreconditioner
from ttus_opt.solvers.primal.split import Split
from ttus_opt.solvers.primal.unseen_fields import UnseenFields

#: A run ends where a round leaves more than this part of the gap [–]
GAIN = 0.5

#: Relative residual of the solve behind `LeastSquares.gap_bound` [–]
BOUND_RTOL = 1e-2


@dataclass(frozen=True)
class LeastSquares:
    """F(p) = min over c of the objective, over the prior's weight.

    Attributes:
        split: The terms.
        complement: Across the columns of the unknowns c that are free.
    """

    split: Split
    complement: Complement = field(repr=False)

    def measure(self, p: Array) -> Array:
        """D p across the columns of c, shape (m,)."""
        return self.complement.part(self.split.few.system.measure(p))

    def field(self, at: Array) -> Array:
        """The field of a point (p, y), shape (V,)."""
        return at[: len(self.split.few.b)]

    def misfit(self, p: Array) -> Array:
        """T - D p, shape (m,)."""
        return self.split.few.t - self.split.few.system.measure(p)

    def coefficients(self, p: Array) -> Array:
        """The best c beside p, shape (k,)."""
        return self.complement.coefficients(self.misfit(p))

    def start(self) -> Array:
        """The given values, zero elsewhere, and zero multipliers."""
        return np.concatenate([self.split.given, np.zeros_like(self.split.few.t)])

    def residual(self, at: Array) -> Array:
        """Residuals (r, s) of both equations; r is zero at given values."""
        p, y = self._halves(at)
        r = self.split.few.system.load(y)
        for term in self._terms:
            r -= term.weight * (term.matrix.T @ term.residual(p))
        s = self.complement.part(self.misfit(p)) - y
        return np.concatenate([np.where(self.split.moving, r, 0.0), s])

    def image(self, along: Array) -> Array:
        """Decrease of both residuals along a direction."""
        p, y = self._halves(along)
        r = -self.split.few.system.load(y)
        for term in self._terms:
            r += term.weight * (term.matrix.T @ (term.matrix @ p))
        return np.concatenate(
            [np.where(self.split.moving, r, 0.0), self.measure(p) + y]
        )

    def pairing(self, rest: Array, along: Array) -> float:
        """(r + Dᵀs)ᵀz, minus half the slope of F along a direction (z, y)."""
        (r, s), (z, _) = self._halves(rest), self._halves(along)
        return inner_product(r, z) + float(s @ self.measure(z))

    def gradient(self, rest: Array) -> Array:
        """Minus half the gradient, shape (V,); zero at given values."""
        r, s = self._halves(rest)
        return np.where(self.split.moving, r + self.split.few.system.load(s), 0.0)

    def value(self, at: Array) -> float:
        """F(p)."""
        p = self.field(at)
        total = float(np.sum(self.complement.part(self.misfit(p)) ** 2))
        for term in self._terms:
            total += term.cost(p)
        return total

    def gap_bound(self, at: Array) -> float:
        """Bound of F(p) - F(p*), up to the solve's error: rᵀA⁻¹r, A of the prior."""
        system = self.split.few.system
        r = self.gradient(self.residual(at))
        u = system.laplace.solve_adjoint(r, rtol=BOUND_RTOL)
        return float(np.sum(system.compliance * u**2))

    @property
    def _terms(self) -> tuple[ProgramTerm, ...]:
        return (self.split.prior, *self.split.wide)

    def _halves(self, both: Array) -> tuple[Array, Array]:
        """The field's part, (V,), and the rows', (m,)."""
        V = len(self.split.few.b)
        return both[:V], both[V:]


def preconditioner(
    split: Split, free: Mask, inner: float = INNER
) -> ConstraintPreconditioner:
    """The preconditioner of a split program.

    Args:
        split: The terms.
        free: Which unknowns beside the field are free, shape (k,).
        inner: As in `ConstraintPreconditioner` [–].
    """
    unseen = UnseenFields.of(split.prior, split.wide, split.moving)
    system = ApproximateSystem.matched(split.few.system, split.wide, unseen)
    return ConstraintPreconditioner(system, split.few.columns[:, free], inner)


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
    function: LeastSquares,
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
