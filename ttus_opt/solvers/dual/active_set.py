"""The active-set iteration: one working set's subproblem after the other.

`primal_dual_active_set` says which working set comes next, and how exactly it is to be
solved.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.laplace.system import RTOL
from ttus_opt.solvers.dual.limits import SpokeLimits
from ttus_opt.solvers.dual.optimality import (
    Multipliers,
    Violations,
    find_violations,
    multipliers,
)
from ttus_opt.solvers.dual.options import Accuracy, DualOptions
from ttus_opt.solvers.dual.solver import DualAnswer
from ttus_opt.solvers.dual.working_set import WorkingSet, one_bound_each


class SolvableSubproblem(Protocol):
    """The problem of a working set, without limits."""

    def solve(self, accuracy: Accuracy, guess: Array | None) -> DualAnswer:
        """The best field, near a guess of shape (V,)."""


class LimitedProblem(Protocol):
    """What the iteration needs of a problem beside its limits."""

    @property
    def options(self) -> DualOptions:
        """Of the method."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Of the grid on which every field lies, (n_r, n_θ, n_z)."""

    @property
    def links_hold_slopes(self) -> bool:
        """Whether links are between neighbours of a field, not between two fields."""

    def subproblem(self, active: WorkingSet) -> SolvableSubproblem:
        """The problem of a working set."""

    def gradient(self, p: Array) -> Array:
        """Gradient of the objective, shape (V,)."""

    def objective(self, p: Array) -> float:
        """The objective."""


@dataclass(frozen=True)
class Goal:
    """What is asked of the iteration.

    Attributes:
        tolerance: KKT tolerance [–].
        rtol: Residual of the dual of the last working set, relative [–].
        deadline: `time.perf_counter` at which to stop; None for never [s].
    """

    tolerance: float
    rtol: float
    deadline: float | None = None


@dataclass(frozen=True)
class ActiveSetAnswer:
    """What the iteration ended with.

    Attributes:
        p: The field, shape (V,).
        multipliers: Of its limits.
        active: The last working set.
        sets: How many were solved [–].
        steps: Directions of all their solves [–].
        late: Whether the deadline cut it short.
        settled: Whether no KKT violation remains but what may.
    """

    p: Array = field(repr=False)
    multipliers: Multipliers = field(repr=False)
    active: WorkingSet
    sets: int
    steps: int
    late: bool
    settled: bool


class ActiveSetIteration:
    """Where the iteration stands.

    Attributes:
        problem: The problem.
        limits: Its limits, those that others imply left out.
        goal: What is asked.
        active: The working set to begin with, then the last one solved.
        settled: Whether no KKT violation remains there but what may.
    """

    def __init__(
        self,
        problem: LimitedProblem,
        limits: SpokeLimits,
        start: tuple[Array, WorkingSet] | None,
        goal: Goal,
    ) -> None:
        """Stand at the start; nothing is solved.

        Args:
            problem: The problem.
            limits: Its limits.
            start: A field, (V,), and the working set to begin with; None for no limit
                active.
            goal: What is asked.
        """
        self.problem, self.limits = problem, limits.without_implied()
        self.goal, self.settled = goal, False
        size = len(limits.lower)
        self.active = WorkingSet.empty(size)
        self._p: Array | None = None
        if start is not None and len(start[0]) == size:
            existing = start[1].existing(self.limits)
            self._p, self.active = start[0], one_bound_each(self.limits, existing)
        self._subproblem: SolvableSubproblem | None = None
        self._multipliers = Multipliers(np.zeros(size), np.zeros(size))
        self._sets, self._steps, self._late = 0, 0, False
        self._acceptable = 0  # working sets with no violation but what may remain

    @property
    def p(self) -> Array:
        """The field of the last working set solved, shape (V,)."""
        assert self._p is not None, "no working set is solved"
        return self._p

    @property
    def over(self) -> bool:
        """Whether there is nothing more to do, or no more time or working sets."""
        enough = self._sets == self.problem.options.max_working_sets
        return self.settled or self._late or enough

    def solve(self, active: WorkingSet, rtol: float) -> Violations:
        """Solve a working set's subproblem.

        Args:
            active: The working set.
            rtol: Residual of its dual, relative [–].

        Returns:
            The KKT violations there.
        """
        options, goal = self.problem.options, self.goal
        if self._subproblem is None or active.differs(self.active):
            self._subproblem, self.active = self.problem.subproblem(active), active
        last = rtol == goal.rtol
        field_rtol = RTOL if last else max(RTOL, options.field_accuracy * rtol)
        accuracy = Accuracy(rtol, field_rtol, goal.deadline)
        answer = self._subproblem.solve(accuracy, self._p)
        self._p = p = answer.p
        self._sets, self._steps = self._sets + 1, self._steps + answer.steps
        self._late = accuracy.late
        gradient = self.problem.gradient(p)
        signs = self._multipliers = multipliers(self.limits, active, gradient)
        margin = options.violation * goal.tolerance
        found = find_violations(self.limits, active, p, signs, gradient, margin)
        acceptable = found.worst + margin <= options.acceptable * goal.tolerance
        self._acceptable += last and acceptable
        done = found.count == 0 or self._acceptable > options.acceptable_sets
        self.settled = last and done and not answer.late
        return found

    def answer(self) -> ActiveSetAnswer:
        """The last working set solved."""
        return ActiveSetAnswer(
            self.p,
            self._multipliers.right_signs(self.limits, self.active),
            self.active,
            self._sets,
            self._steps,
            self._late,
            self.settled,
        )
