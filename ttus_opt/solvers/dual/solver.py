"""The minimiser of Σ (L p - b)²/ω + ‖D p - t‖² through its dual.

Conjugate directions, all kept (`conjugate_directions`), preconditioned by a rough
dual (`rough`), and rounds of refinement for what inexact products left.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.laplace.system import RTOL
from ttus_opt.solvers.dual.conjugate_directions import Directions, solve_dual
from ttus_opt.solvers.dual.preconditioner import rough_preconditioner
from ttus_opt.solvers.dual.system import DualSystem

#: Most directions
MAX_STEPS = 2000

#: Where no less is asked for, the multipliers of a face nearby are no better to begin
#: with than none, and cost a response: residual of the dual, relative [–]
NEARBY = 3e-4

#: Most rounds of solving for the residual that inexact products left; they end where
#: one leaves more than this part of what was there before [–]
ROUNDS, GAINED = 8, 0.5


@dataclass(frozen=True)
class DualAnswer:
    """Result of one solve.

    Attributes:
        p: The minimiser, shape (V,).
        steps: New directions [–].
        late: Whether the deadline cut it short.
    """

    p: Array = field(repr=False)
    steps: int
    late: bool


class DualSolver:
    """One dual system, its directions and its preconditioner."""

    def __init__(self, system: DualSystem) -> None:
        self._directions = Directions(system)
        self._precondition: Callable[[Array], Array] | None = None
        self._base: tuple[Array, float, Array] | None = None

    @property
    def system(self) -> DualSystem:
        """The system."""
        return self._directions.system

    def adopt(self, system: DualSystem) -> None:
        """Take a system with other weights of the same rows; no solve is spent."""
        self._directions.adopt(system)
        self._precondition = None

    def solve(
        self,
        b: Array,
        t: Array,
        *,
        rtol: float,
        deadline: float | None = None,
        guess: Array | None = None,
        field_rtol: float = RTOL,
    ) -> DualAnswer:
        """Solve for one right-hand side.

        Args:
            b: Of L p = b, shape (V,).
            t: Weighted targets, shape (m,).
            rtol: Residual of the dual, relative to t - D p₀ [–].
            deadline: `time.perf_counter` at which to stop; None for never [s].
            guess: A field near the answer, shape (V,).
            field_rtol: Residual of the solves behind the answer's field, relative [–].

        Returns:
            The answer; whether it is exact is for the caller to verify.
        """
        system = self.system
        base = self._prior_field(b, field_rtol)
        right_side = t - system.measure(base)
        goal = rtol * float(np.linalg.norm(right_side))
        if guess is None:
            y, p, residual = np.zeros_like(right_side), base, right_side
        else:
            y = t - system.measure(guess)
            p = base + system.response(y, field_rtol)
            residual = right_side - y - system.measure(p - base)
        steps, before = 0, np.inf
        for _ in range(ROUNDS):
            size = float(np.linalg.norm(residual))
            if size <= goal or size > GAINED * before:
                break
            before = size
            if self._precondition is None:
                self._precondition = rough_preconditioner(system)
            step, taken = solve_dual(
                self._directions,
                residual,
                goal,
                self._precondition,
                max_steps=MAX_STEPS - steps,
                deadline=deadline,
            )
            y, steps = y + step, steps + taken
            # added to p, not made of all of y again: measurements that contradict each
            # other leave a large y, whose rounding would then be all the accuracy
            p = p + system.response(step, field_rtol)
            if deadline is not None and time.perf_counter() > deadline:
                return DualAnswer(p, steps, late=True)
            residual = t - system.measure(p) - y
        return DualAnswer(p, steps, late=False)

    def _prior_field(self, b: Array, rtol: float) -> Array:
        """p₀ = L⁻¹b, kept while b stays and no more is asked of it."""
        kept = self._base
        if kept is None or rtol < kept[1] or not np.array_equal(kept[0], b):
            kept = self._base = b, rtol, self.system.laplace.solve(b, rtol=rtol)
        return kept[2]
