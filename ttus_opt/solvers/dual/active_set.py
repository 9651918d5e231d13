"""State of the active-set iteration, which solves one working set after another.

`primal_dual_active_set` chooses the next working set and the accuracy of its solve.
"""

from __future__ import annotations

import math
from typing import Protocol, runtime_checkable

import numpy as np

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.laplace.system import RTOL
from ttus_opt.problem.verify.gradient_blocks import ROUNDING
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

#: KKT violation that may remain, over the KKT tolerance, and working sets with such
#: violations alone before the iteration ends: thousands of limits may be so close to
#: active that it hardly matters which ones are [–]
ACCEPTABLE, ACCEPTABLE_SETS = 0.1, 2


class SolvableSubproblem(Protocol):
    """The problem of a working set, without limits."""

    def solve(self, accuracy: Accuracy, last: Array | None) -> DualAnswer:
        """The minimiser; ``last`` is that of the last working set, shape (V,)."""


class LimitedProblem(Protocol):
    """A problem with limits, as the iteration sees it."""

    @property
    def options(self) -> DualOptions:
        """Options of the method."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of the grid of every field, (n_r, n_θ, n_z)."""

    @property
    def links_along_spokes(self) -> bool:
        """Whether links are between neighbours of a field, not between two fields."""

    @property
    def alone(self) -> Mask | bool:
        """Unknowns that a row of their own pulls to a value, such as soft values."""

    def subproblem(self, active: WorkingSet) -> SolvableSubproblem:
        """The problem of a working set."""

    def gradient(self, p: Array) -> Array:
        """Gradient of the objective, shape (V,)."""

    def objective(self, p: Array) -> float:
        """The objective."""


@runtime_checkable
class PredictingProblem(Protocol):
    """A problem with a model of the response of its field to multipliers of bounds."""

    @property
    def predicts_roughly(self) -> bool:
        """Whether a rough minimiser is enough for the next prediction."""

    def predicted(
        self, active: WorkingSet, p: Array, signs: Multipliers
    ) -> WorkingSet | None:
        """The next working set by the model.

        Args:
            active: The working set, without links.
            p: Its minimiser, shape (V,).
            signs: Its multipliers.

        Returns:
            The next one; None if there is no model or nothing changes.
        """


class ActiveSetIteration:
    """State of the iteration.

    Attributes:
        problem: The problem.
        limits: Its limits without redundant ones.
        active: The initial working set, then the last one solved.
        rtol: Relative residual of the final working set's dual [–].
        signs: Multipliers of the last working set's limits.
        multipliers: The same without wrong signs.
        sets: Number of working sets solved [–].
        steps: Number of directions of all solves [–].
        late: Whether the deadline has passed.
        settled: Whether only acceptable KKT violations remain.
    """

    def __init__(
        self,
        problem: LimitedProblem,
        limits: SpokeLimits,
        start: tuple[Array, WorkingSet] | None,
        tolerance: float,
        accuracy: Accuracy,
    ) -> None:
        """Set up the initial state; nothing is solved.

        Args:
            problem: The problem.
            limits: Its limits.
            start: A field, (V,), and the initial working set; None for an empty one.
            tolerance: KKT tolerance [–].
            accuracy: Accuracy of the final working set.
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
        self._acceptable = 0  # working sets with acceptable violations only

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
        """Whether the problem is solved, or time or working sets are used up."""
        enough = self.sets == self.problem.options.max_working_sets
        return self.settled or self.late or enough

    @property
    def predicts_roughly(self) -> bool:
        """Whether the problem's model needs only a rough minimiser."""
        problem = self.problem
        return isinstance(problem, PredictingProblem) and problem.predicts_roughly

    def predicted(self, found: Violations) -> WorkingSet | None:
        """The working set that a model of the bounds predicts; None without one.

        Args:
            found: The KKT violations of the last working set.
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
            rtol: Relative residual of its dual [–].

        Returns:
            Its KKT violations.
        """
        options = self.problem.options
        if self._subproblem is None or active.differs(self.active):
            self._subproblem = None  # freed before the next one is allocated
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
        acceptable = found.worst <= ACCEPTABLE * self._tolerance * share
        self._acceptable += last and acceptable
        done = found.count == 0 or self._acceptable > ACCEPTABLE_SETS
        self.settled = last and done and not answer.late
        return found


def _least_share(values: Array, n_fields: int) -> float:
    """Size of the smallest field over that of the largest [–].

    KKT residuals are relative to each field's own size, violations to the largest one.
    """
    sizes = np.abs(values).reshape(n_fields, -1).max(axis=1)
    least, most = float(sizes.min()), float(sizes.max())
    return max(least / most, ROUNDING) if most > 0.0 else 1.0
