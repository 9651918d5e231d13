"""Fields and one unknown more in one dual solve.

With an unknown c beside the fields, D p + E c = t, multipliers y and c satisfy

    (I + K) y + E c = t - D p₀,   Eᵀy = 0,

where c is within its bounds; at a bound it is a given number. Conjugate directions
with Eᵀd = 0 solve both at once: what the residual then has along E is c. So a face
costs one dual solve, `few_columns` costs one more.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.laplace.system import RTOL
from ttus_opt.solvers.dual.conjugate_directions import GROWN, LOOSEST, Directions
from ttus_opt.solvers.dual.preconditioner import rough_preconditioner
from ttus_opt.solvers.dual.solver import MAX_STEPS, ROUNDS
from ttus_opt.solvers.dual.system import DualSystem

#: A slope of c below this part of what it is made of is none [–]
FLAT = 1e-10


@dataclass(frozen=True)
class BorderedAnswer:
    """Fields and the unknown beside them.

    Attributes:
        p: Shape (V,).
        c: The unknown.
        steps: New directions [–].
        late: Whether the deadline cut it short.
    """

    p: Array = field(repr=False)
    c: float
    steps: int
    late: bool


@dataclass(frozen=True)
class _Multipliers:
    """y and the fields L⁻¹ ω L⁻ᵀ Dᵀy they make."""

    y: Array
    p: Array


class BorderedSolver:
    """One dual system with one column, and its directions."""

    def __init__(
        self, system: DualSystem, column: Array, bounds: tuple[float, float]
    ) -> None:
        """Take a problem.

        Args:
            system: Of the fields alone.
            column: E with the rows' weights, shape (m,).
            bounds: Of c.
        """
        self.system = system
        self._column, self._bounds = column, bounds
        self._square = float(column @ column)
        self._directions = Directions(system)
        self._across = True  # whether all directions are across E
        self._precondition: Callable[[Array], Array] | None = None
        self._steps = 0
        self._deadline: float | None = None
        self._field_rtol = RTOL

    def solve(
        self,
        b: Array,
        t: Array,
        *,
        near: float,
        guess: Array | None = None,
        rtol: float,
        field_rtol: float,
        deadline: float | None,
    ) -> BorderedAnswer:
        """Solve for one right-hand side.

        Args:
            b: Of L p = b, shape (V,).
            t: Weighted targets, shape (m,).
            near: Where c may lie; at a bound it is tried first whether it stays.
            guess: Fields near the answer, shape (V,).
            rtol: Residual of the dual, relative to t - D p₀ [–].
            field_rtol: Residual of the solves behind the answer's field, relative [–].
            deadline: `time.perf_counter` at which to stop; None for never [s].
        """
        system, (low, high) = self.system, self._bounds
        self._steps, self._deadline = 0, deadline
        self._field_rtol = field_rtol
        base = system.laplace.solve(b, rtol=field_rtol)
        right_side = t - system.measure(base)
        goal = rtol * float(np.linalg.norm(right_side))
        misfit = None if guess is None else t - system.measure(guess)
        c = min(max(near, low), high)
        loose = low < c < high and self._square > 0.0
        if not loose:
            start = None if misfit is None else misfit - c * self._column
            answer, _ = self._given(right_side, c, self._start(start), goal)
            slope = float(self._column @ answer.y)
            flat = FLAT * np.sqrt(self._square) * float(np.linalg.norm(answer.y))
            loose = (c < high and slope > flat) or (c > low and slope < -flat)
        if loose:
            answer, c = self._loose(right_side, misfit, goal)
            if not low <= c <= high:
                c = min(max(c, low), high)
                answer, _ = self._given(right_side, c, answer, goal)
        return BorderedAnswer(base + answer.p, c, self._steps, self._late)

    @property
    def _late(self) -> bool:
        return self._deadline is not None and time.perf_counter() > self._deadline

    def _given(
        self, right_side: Array, c: float, start: _Multipliers, goal: float
    ) -> tuple[_Multipliers, float]:
        """Multipliers where c is given."""
        self._across = False
        rest = right_side - c * self._column
        return self._solved(rest, start, goal, lambda r: (0.0, r), self._rough)

    def _loose(
        self, right_side: Array, misfit: Array | None, goal: float
    ) -> tuple[_Multipliers, float]:
        """Multipliers across E, and c."""
        if not self._across:
            self._directions, self._across = Directions(self.system), True
        column, square = self._column, self._square

        def split(residual: Array) -> tuple[float, Array]:
            c = float(column @ residual) / square
            return c, residual - c * column

        made = self._rough(column)
        size = float(column @ made)

        def across(residual: Array) -> Array:
            z = self._rough(residual)
            return z - float(column @ z) / size * made

        start = self._start(None if misfit is None else split(misfit)[1])
        return self._solved(right_side, start, goal, split, across)

    def _start(self, y: Array | None) -> _Multipliers:
        """Multipliers to begin with, zero for None."""
        system = self.system
        if y is None:
            nothing = np.zeros_like(system.root_weights)
            return _Multipliers(nothing, np.zeros_like(system.softness))
        return _Multipliers(y, system.response(y, self._field_rtol))

    def _rough(self, residual: Array) -> Array:
        if self._precondition is None:
            self._precondition = rough_preconditioner(self.system)
        return self._precondition(residual)

    def _solved(
        self,
        right_side: Array,
        start: _Multipliers,
        goal: float,
        split: Callable[[Array], tuple[float, Array]],
        precondition: Callable[[Array], Array],
    ) -> tuple[_Multipliers, float]:
        """Multipliers from a start on, and what `split` takes of the residual."""
        y, p = start.y, start.p
        c, residual = split(right_side - y - self.system.measure(p))
        for _ in range(ROUNDS):
            if np.linalg.norm(residual) <= goal or self._late:
                break
            step, residual = self._directions.project(residual)
            y, best, least = y + step, y, np.inf
            while (
                size := float(np.linalg.norm(rest := split(residual)[1]))
            ) > goal and not (self._late or self._steps == MAX_STEPS):
                if size < least:
                    best, least = y, size
                if not size <= GROWN * least:
                    y = best
                    break
                rtol = min(max(0.1 * goal / size, RTOL), LOOSEST)
                self._directions.extend(precondition(rest), rtol)
                step, residual = self._directions.project(residual)
                y, self._steps = y + step, self._steps + 1
            p = self.system.response(y, self._field_rtol)
            c, residual = split(right_side - y - self.system.measure(p))
        return _Multipliers(y, p), c
