"""The active-set iteration: one working set's subproblem after the other.

`primal_dual_active_set` says which working set comes next, and how exactly it is to be
solved.
"""

from __future__ import annotations

import math
from typing import Protocol, runtime_checkable

import numpy as np

from ttus_opt.arrays import Array, Mask
from ttus_opt.laplace.system import RTOL
from ttus_opt.problem.gradient_blocks import ROUNDING
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

    def solve(self, accuracy: Accuracy, last: Array | None) -> DualAnswer:
        """The best field, after that of the last working set, shape (V,)."""


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

    @property
    def alone(self) -> Mask | bool:
        """Unknowns that a row of their own draws to a value, not their neighbours."""

    def subproblem(self, active: WorkingSet) -> SolvableSubproblem:
        """The problem of a working set."""

    def gradient(self, p: Array) -> Array:
        """Gradient of the objective, shape (V,)."""

    def objective(self, p: Array) -> float:
        """The objective."""


@runtime_checkable
class PredictingProblem(Protocol):
    """A problem with a model of how its field answers to multipliers of bounds."""

    @property
    def predicts_roughly(self) -> bool:
        """Whether the next prediction needs no more than a rough minimiser."""

    def predicted(
        self, active: WorkingSet, p: Array, signs: Multipliers
    ) -> WorkingSet | None:
        """The working set to which the model leads from one without links.

        Args:
            active: The working set.
            p: Its minimiser, shape (V,).
            signs: Its multipliers, as the gradient has them.

        Returns:
            The next one; None where there is no model or it changes nothing.
        """


class ActiveSetIteration:
    """Where the iteration stands.

    Attributes:
        problem: The problem.
        limits: Its limits, those that others imply left out.
        active: The working set to begin with, then the last one solved.
        rtol: Residual of the dual of the last working set, relative [–].
        signs: Multipliers of its limits.
        multipliers: The same with the right signs.
        sets: Working sets solved [–].
        steps: Directions of all their solves [–].
        late: Whether the deadline is over.
        settled: Whether no KKT violation remains but what may.
    """

    def __init__(
        self,
        problem: LimitedProblem,
        limits: SpokeLimits,
        start: tuple[Array, WorkingSet] | None,
        tolerance: float,
        accuracy: Accuracy,
    ) -> None:
        """Stand at the start; nothing is solved.

        Args:
            problem: The problem.
            limits: Its limits.
            start: A field, (V,), and the working set to begin with; None for no limit
                active.
            tolerance: KKT tolerance [–].
            accuracy: Of the last working set.
        """
        self.problem, self.limits = problem, limits.without_implied()
        self.rtol, self._tolerance = accuracy.rtol, tolerance
        self._deadline = accuracy.deadline
        size = len(limits.lower)
        self.active, self._p = WorkingSet.empty(size), None
        if start is not None and len(start[0]) == size:
            self._p, active = start[0], start[1].existing(self.limits)
            self.active = one_bound_each(self.limits, active)
        self._subproblem: SolvableSubproblem | None = None
        self.sets, self.steps, self.late, self.settled = 0, 0, False, False
        self._acceptable = 0  # working sets with no violation but what may remain

    _p: Array | None
    signs: Multipliers
    multipliers: Multipliers

    @property
    def p(self) -> Array:
        """The field of the last working set solved, shape (V,)."""
        assert self._p is not None, "no working set is solved"
        return self._p

    @property
    def over(self) -> bool:
        """Whether there is nothing more to do, or no more time or working sets."""
        enough = self.sets == self.problem.options.max_working_sets
        return self.settled or self.late or enough

    @property
    def predicts_roughly(self) -> bool:
        """Whether the problem does."""
        problem = self.problem
        return isinstance(problem, PredictingProblem) and problem.predicts_roughly

    def predicted(self, found: Violations) -> WorkingSet | None:
        """The working set to which a model of bounds alone leads; None for none.

        Args:
            found: The KKT violations of the last one.
        """
        problem = self.problem
        if self.active.links.any() or (found.links > 0.0).any():
            return None
        if not isinstance(problem, PredictingProblem):
            return None
        return problem.predicted(self.active, self.p, self.signs)

    def solve(self, active: WorkingSet, rtol: float) -> Violations:
        """Solve a working set's subproblem.

        Args:
            active: The working set.
            rtol: Residual of its dual, relative [–].

        Returns:
            The KKT violations there.
        """
        options = self.problem.options
        if self._subproblem is None or active.differs(self.active):
            self._subproblem = None  # let go of before the next one is made
            self._subproblem, self.active = self.problem.subproblem(active), active
        last = rtol == self.rtol
        field_rtol = RTOL if last else max(RTOL, options.field_accuracy * rtol)
        accuracy = Accuracy(rtol, field_rtol, self._deadline)
        answer = self._subproblem.solve(accuracy, self._p)
        self._p = p = answer.p
        self.sets, self.steps = self.sets + 1, self.steps + answer.steps
        self.late = accuracy.late
        gradient = self.problem.gradient(p)
        self.signs = signs = multipliers(self.limits, active, gradient)
        self.multipliers = signs.right_signs(self.limits, active)
        found = find_violations(self.limits, active, p, signs, gradient)
        n_fields = len(p) // math.prod(self.problem.shape)
        share = min(_least_share(p, n_fields), _least_share(gradient, n_fields))
        acceptable = found.worst <= options.acceptable * self._tolerance * share
        self._acceptable += last and acceptable
        done = found.count == 0 or self._acceptable > options.acceptable_sets
        self.settled = last and done and not answer.late
        return found


def _least_share(values: Array, n_fields: int) -> float:
    """Size of the smallest of some fields over the largest's [–].

    The KKT residuals are relative to each field's own size, violations to the largest.
    """
    sizes = np.abs(values).reshape(n_fields, -1).max(axis=1)
    least, most = float(sizes.min()), float(sizes.max())
    return max(least / most, ROUNDING) if most > 0.0 else 1.0
