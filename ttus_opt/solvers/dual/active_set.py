"""Faces solved one after the other; `exchange` says which comes next, how exactly."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.laplace.system import RTOL
from ttus_opt.solvers.dual.activity import Activity, no_limits_active
from ttus_opt.solvers.dual.limits import SpokeLimits
from ttus_opt.solvers.dual.optimality import (
    Wrong,
    find_wrong,
    multipliers,
    one_pin_each,
    possible,
    right_signs,
)
from ttus_opt.solvers.dual.solver import DualAnswer

#: Most faces
MAX_FACES = 100

#: Residual of the solves behind a field that is not yet the last, over its dual's [–]
FINER = 1e-3

#: What may be an error of the field only, over the residual of the dual: where a limit
#: holds with equality by itself, its voxels are no violations [–]
DOUBTFUL = 0.1

#: What counts as a violation or a wrong sign, over the KKT tolerance; what may be left
#: where that takes more than so many faces more: thousands of limits may lie so near
#: to active that it hardly matters which of them are [–]
MARGIN, ENOUGH, MORE = 1e-3, 0.1, 2


class SolvableFace(Protocol):
    """A face of the feasible set."""

    def solve(
        self,
        *,
        rtol: float,
        field_rtol: float = RTOL,
        deadline: float | None,
        guess: Array | None,
    ) -> DualAnswer:
        """The best field on it, near a guess, as `DualSolver.solve` gives it."""


class LimitedProblem(Protocol):
    """What the search needs of a problem beside its limits."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Of the grid on which every field lies, (n_r, n_θ, n_z)."""

    @property
    def links_hold_slopes(self) -> bool:
        """Whether links are between neighbours of a field, not between two fields."""

    def face(self, active: Activity) -> SolvableFace:
        """The problem left when some limits are active."""

    def gradient(self, p: Array) -> Array:
        """Gradient of the objective, shape (V,)."""

    def objective(self, p: Array) -> float:
        """The objective."""


@dataclass(frozen=True)
class FaceAnswer:
    """What the search ended with.

    Attributes:
        p: The field, shape (V,).
        pull: Multipliers of bounds and given values, positive at upper limits, (V,).
        push: Multipliers of links, at their deeper voxel, not negative, (V,).
        active: The face.
        faces: How many were solved [–].
        steps: Directions of all their solves [–].
        late: Whether the deadline cut it short.
        settled: Whether nothing is wrong on the last face but what may be left.
    """

    p: Array = field(repr=False)
    pull: Array = field(repr=False)
    push: Array = field(repr=False)
    active: Activity
    faces: int
    steps: int
    late: bool
    settled: bool


class FaceWalk:
    """Where a search stands.

    Attributes:
        problem: Its faces, and its gradient, which multipliers come from.
        limits: Its limits, those that others imply left out.
        active: The face to begin with, then the last one solved.
        rtol: Residual of the dual on the last face, relative [–].
        settled: Whether nothing is wrong on the last face but what may be left.
    """

    def __init__(
        self,
        problem: LimitedProblem,
        limits: SpokeLimits,
        start: tuple[Array, Activity] | None,
        *,
        tolerance: float,
        rtol: float,
        deadline: float | None,
    ) -> None:
        """Stand at the start; nothing is solved.

        Args:
            problem: The problem.
            limits: Its limits.
            start: A field, (V,), and the face to begin with; None for no limit active.
            tolerance: KKT tolerance [–].
            rtol: Residual of the dual on the last face, relative [–].
            deadline: `time.perf_counter` at which to stop; None for never [s].
        """
        self.problem, self.limits = problem, limits.without_implied()
        self.rtol, self.settled = rtol, False
        self._tolerance, self._deadline = tolerance, deadline
        size = len(limits.lower)
        self.active = no_limits_active(size)
        self._p: Array | None = None
        if start is not None and len(start[0]) == size:
            there = possible(self.limits, start[1])
            self._p, self.active = start[0], one_pin_each(self.limits, there)
        self._face: SolvableFace | None = None
        self._signs = np.zeros(size), np.zeros(size)
        self._faces, self._steps, self._late = 0, 0, False
        self._near = 0  # faces with nothing wrong but what may be left

    @property
    def p(self) -> Array:
        """The field on the last face solved, shape (V,)."""
        assert self._p is not None, "no face is solved"
        return self._p

    @property
    def over(self) -> bool:
        """Whether there is nothing more to do, or no more time or faces."""
        return self.settled or self._late or self._faces == MAX_FACES

    def solve(self, active: Activity, accuracy: float) -> Wrong:
        """Solve a face.

        Args:
            active: The face.
            accuracy: Residual of its dual, relative [–].

        Returns:
            What is wrong there.
        """
        if self._face is None or active.differs(self.active):
            self._face, self.active = self.problem.face(active), active
        last = accuracy == self.rtol
        field_rtol = RTOL if last else max(RTOL, FINER * accuracy)
        answer = self._face.solve(
            rtol=accuracy,
            field_rtol=field_rtol,
            deadline=self._deadline,
            guess=self._p,
        )
        self._p = p = answer.p
        self._faces, self._steps = self._faces + 1, self._steps + answer.steps
        gradient = self.problem.gradient(p)
        self._signs = pull, push = multipliers(self.limits, active, gradient)
        self._late = self._deadline is not None and time.perf_counter() > self._deadline
        margin = MARGIN * self._tolerance
        margins = margin, max(margin, DOUBTFUL * accuracy)
        wrong = find_wrong(self.limits, active, p, pull, push, gradient, *margins)
        self._near += last and wrong.worst + margin <= ENOUGH * self._tolerance
        done = wrong.count == 0 or self._near > MORE
        self.settled = last and done and not answer.late
        return wrong

    def answer(self) -> FaceAnswer:
        """The last face solved."""
        pull, push = right_signs(self.limits, self.active, *self._signs)
        return FaceAnswer(
            self.p,
            pull,
            push,
            self.active,
            self._faces,
            self._steps,
            self._late,
            self.settled,
        )
