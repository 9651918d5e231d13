"""The method of multipliers, proximal, with semismooth Newton steps inside.

Each round minimises the augmented Lagrangian

    Σ_k e_k(x) + ½ ‖E (x − x̄)‖²

by Newton steps on its (nearly) piecewise linear gradient with an exact line search, to
an accuracy relative to the round's progress. Then y ← y⁺, x̄ ← x, and σ grows. The
second summand (the anchor) is present where squares do not determine x.

Source: R. T. Rockafellar, Augmented Lagrangians and Applications of the Proximal Point
Algorithm in Convex Programming (1976); X. Li, D. Sun, K.-C. Toh, A Highly Efficient
Semismooth Newton Augmented Lagrangian Method for Solving Lasso Problems (2018).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.problem.terms.penalties import Slope
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers.base import Candidate, Claim, Request, is_late
from ttus_opt.solvers.conjugate_gradients import inner_product, norm
from ttus_opt.solvers.proximal.field_newton import FieldNewton
from ttus_opt.solvers.proximal.laplace_newton import LaplaceNewton
from ttus_opt.solvers.proximal.penalised_rows import PenalisedRows
from ttus_opt.solvers.proximal.problem import PenalisedProblem

NewtonSystem = LaplaceNewton | FieldNewton

#: After a step length below this the next Newton step is cautious [–]
SHORT = 0.3

#: Factor on the residual of Newton systems after a round that fell short, and its least
#: value [–]
TIGHTENING, LEAST_RTOL = 0.1, 1e-9

#: Most rounds, and most Newton steps of a round
ROUNDS, NEWTON_STEPS = 150, 5

#: A round is complete when the remaining decrease of the Lagrangian is below this part,
#: squared, of the multipliers' movement [–]
SHARE = 0.1

#: Factor on σ, and inverse factor on the anchor, after a complete round; inverse factor
#: on σ, and factor on the anchor, after another [–]
GROWTH, RETREAT = 2.0, 1.5

#: Slope at the end of a line search over that at its start, its most evaluations, and
#: distance of a secant step from the ends of the bracket, over its width [–]
FLAT, EVALUATIONS, MARGIN = 0.1, 20, 0.1


@dataclass
class State:
    """An iterate.

    Attributes:
        x: Shape (n,).
        residuals: Residuals of every block.
        multipliers: y⁺ of every block.
        slopes: Slopes of every block.
        parts: Mᵀy⁺ of every block.
    """

    x: Array
    residuals: list[Array]
    multipliers: list[Array] = field(default_factory=list)
    slopes: list[Slope] = field(default_factory=list)
    parts: list[Array] = field(default_factory=list)

    @classmethod
    def of(cls, x: Array, blocks: Sequence[PenalisedRows]) -> State:
        """The state at a point."""
        state = cls(x, [b.residual(x) for b in blocks])
        state.evaluate(blocks)
        return state

    def evaluate(self, blocks: Sequence[PenalisedRows]) -> None:
        """Multipliers and slopes at x."""
        pairs = [b.charged(r) for b, r in zip(blocks, self.residuals, strict=True)]
        self.multipliers = [y for y, _ in pairs]
        self.slopes = [slope for _, slope in pairs]
        self.parts = [
            b.adjoint(y) for b, y in zip(blocks, self.multipliers, strict=True)
        ]

    @property
    def gradient(self) -> Array:
        """Gradient of the augmented Lagrangian, shape (n,)."""
        return np.asarray(np.sum(self.parts, axis=0))


class MethodOfMultipliers:
    """The iteration on one problem.

    Attributes:
        newton_steps: Newton steps so far.
        steps: Inner iterations of these.
    """

    def __init__(
        self,
        problem: PenalisedProblem,
        system: NewtonSystem,
        request: Request,
    ) -> None:
        """Take a problem.

        Args:
            problem: The problem, with its anchor.
            system: Solves for the steps.
            request: Tolerance and time limit.
        """
        self._problem, self._blocks = problem, problem.blocks
        self._system, self._request = system, request
        self.steps = self.newton_steps = 0
        self._length = 0.0  # of the last step; none at the start

    def solve(self, x: Array) -> Candidate:
        """Solve from a starting point.

        Args:
            x: Shape (n,), given values included; the anchor is there.
        """
        self._deadline = self._request.deadline()
        state = State(x, [b.residual(x) for b in self._blocks])
        best, least, stale = Candidate(x, claim=Claim.TIME_LIMIT), np.inf, 0
        # without multiplier estimates, one round minimises the objective itself
        most = 25 if self._problem.bent else 3
        rtol = self._system.rtol
        for _ in range(ROUNDS):
            done = self._minimise(state, rtol)
            duals = self._problem.duals(state.multipliers, state.gradient)
            kkt = kkt_residuals(
                self._problem.program, state.x, duals, tolerance=self._request.tolerance
            )
            if kkt.worst_relative < least:
                stale = 0 if kkt.worst_relative < 0.9 * least else stale + 1
                best, least = Candidate(state.x, duals), kkt.worst_relative
                self._request.tell(least)
            else:
                stale += 1
            if least <= self._request.tolerance or stale > most or self._late:
                break
            rtol *= TIGHTENING if not done else 1.0 / TIGHTENING
            rtol = min(max(rtol, LEAST_RTOL), self._system.rtol)
            self._next_round(state, GROWTH if done else 1.0 / RETREAT)
        if least <= self._request.tolerance:
            return best
        return replace(best, claim=Claim.TIME_LIMIT if self._late else Claim.GAVE_UP)

    @property
    def _late(self) -> bool:
        return is_late(self._deadline)

    def _minimise(self, state: State, rtol: float) -> bool:
        """Take Newton steps; whether the round is complete."""
        blocks, fixed = self._blocks, self._problem.fixed
        state.evaluate(blocks)
        for _ in range(NEWTON_STEPS):
            gradient = np.where(fixed, 0.0, state.gradient)
            given = gradient, state.multipliers, self._slopes(state)
            d, spent = self._system.step(*given, rtol, self._deadline)
            self.steps, self.newton_steps = self.steps + spent, self.newton_steps + 1
            d = np.where(fixed, 0.0, d)
            start = inner_product(gradient, d)
            if not (np.isfinite(start) and start < 0.0):
                if self._length < SHORT:
                    return True
                self._length = 0.5 * SHORT
                continue
            changes = [np.asarray(b.matrix @ d) for b in blocks]
            slope = partial(self._slope, state, changes)
            length, end = line_search(slope, start)
            self._system.taken(length)
            self._length = length
            state.x = state.x + length * d
            for r, change in zip(state.residuals, changes, strict=True):
                r += length * change
            state.evaluate(blocks)
            left = max(abs(end), rtol**2 * -start) if length == 1.0 else np.inf
            if left <= SHARE**2 * self._moved(state) or self._late:
                return True
            if self._small(state):
                return True
        return False

    def _slopes(self, state: State) -> list[Slope]:
        """Newton's slopes; after a short step, larger ones of exact penalties.

        Rows beyond a kink have no slope, so that a Newton step may be far too long.
        The slope at zero residual, or the secant to the present one (reweighted least
        squares), majorises the penalty.
        """
        if self._length >= SHORT:
            return state.slopes
        slopes = []
        for b, slope, r, y in zip(
            self._blocks, state.slopes, state.residuals, state.multipliers, strict=True
        ):
            if b.exact and slope.along is None:
                steepest = b.charged(np.zeros_like(r))[1].factor
                if self._length > 0.0:
                    bent = y * r > 0.0
                    secant = np.where(bent, y, 1.0) / np.where(bent, r, 1.0)
                    steepest = np.where(bent, np.minimum(secant, steepest), steepest)
                slope = Slope(np.maximum(steepest, slope.factor))
            slopes.append(slope)
        return slopes

    def _small(self, state: State) -> bool:
        """Whether the gradient is far below its summands."""
        free = ~self._problem.fixed
        size = norm(state.gradient[free])
        largest = max(norm(part[free]) for part in state.parts)
        return size <= 0.1 * self._request.tolerance * largest

    def _slope(self, state: State, changes: list[Array], length: float) -> float:
        """Slope of the augmented Lagrangian along a step."""
        total = 0.0
        for b, r, change in zip(self._blocks, state.residuals, changes, strict=True):
            y, _ = b.charged(r + length * change)
            total += inner_product(y, change)
        return total

    def _moved(self, state: State) -> float:
        """Movement of estimates and anchor, in the unit of the Lagrangian."""
        rows = zip(self._blocks, state.residuals, state.multipliers, strict=True)
        return sum(b.moved(r, y) for b, r, y in rows)

    def _next_round(self, state: State, growth: float) -> None:
        """Update estimates, anchor and σ."""
        for b, y in zip(self._blocks, state.multipliers, strict=True):
            b.follow(state.x, y, growth)
        # recomputed: sums of steps collect rounding errors
        state.residuals = [b.residual(state.x) for b in self._blocks]


def line_search(slope: Callable[[float], float], start: float) -> tuple[float, float]:
    """A step length at which a slope is nearly zero, by secants and bisection.

    Args:
        slope: Slope at a step length, not decreasing.
        start: Slope at zero, negative.

    Returns:
        The step length, at most 1, and the slope there.
    """
    low, high = 0.0, 1.0
    at_low, at_high = start, slope(1.0)
    if at_high <= -FLAT * start:
        return 1.0, at_high
    step, now = high, at_high
    for _ in range(EVALUATIONS):
        width = high - low
        step = low - at_low * width / (at_high - at_low)
        step = min(max(step, low + MARGIN * width), high - MARGIN * width)
        now = slope(step)
        if abs(now) <= -FLAT * start:
            break
        if now > 0.0:
            high, at_high = step, now
        else:
            low, at_low = step, now
    return step, now
