"""The primal-dual active-set method with a safeguard (docs/method, section 10.6).

For each working set the problem without limits is solved. Active limits whose
multiplier has the wrong sign are released, all at once (block pivoting: Júdice and
Pires, Comput. Oper. Res. 21, 1994; Bergounioux, Ito and Kunisch, SIAM J. Control Optim.
37, 1999). Which of the violated limits become active depends on their kind:

- Bounds: local maxima of the violation, because a field with a second-order prior
  touches its bound at few points (10 to 20 working sets, 50 and more with all violated
  bounds).
- Bounds of soft values, which a row of their own pulls to a value: all violated ones,
  because they hardly affect each other (a third of the working sets).
- Order along spokes: all whose violation exceeds a share of the worst nearby, because
  active order constraints fill volumes.

If a problem has a model of its field's response to multipliers (`touched_limits`,
`soft_values`) and only bounds are violated, the model predicts the next working set.

Changing all limits at once is fast but may cycle. The safeguard then activates violated
limits only from a working set without wrong signs, as in Lawson and Hanson's method.
The solution of such a set is the minimiser with its limits as inequalities, whose
objective can only rise with every added limit. If it has not risen, fewer limits are
added, so no working set without wrong signs occurs twice.
"""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass, field
from typing import ClassVar, Protocol

import numpy as np
from scipy.ndimage import maximum_filter

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.laplace.system import RTOL
from ttus_opt.problem.program import Program
from ttus_opt.problem.verify.kkt import Duals
from ttus_opt.problem.verify.relative_residuals import ROUNDING
from ttus_opt.solvers.dual import options
from ttus_opt.solvers.dual.limits import Multipliers, SpokeLimits
from ttus_opt.solvers.dual.optimality import (
    Violations,
    find_violations,
    multipliers,
    right_signs,
)
from ttus_opt.solvers.dual.solver import Accuracy, DualAnswer
from ttus_opt.solvers.dual.working_set import WorkingSet, one_bound_each

#: KKT violation that may remain, over the KKT tolerance, and working sets with such
#: violations alone before the iteration ends: thousands of limits may be so close to
#: active that it hardly matters which ones are [–]
ACCEPTABLE, ACCEPTABLE_SETS = 0.1, 2

#: Relative residual of the last dual over the KKT tolerance [–]
DUAL_MARGIN = 1e-2

#: It is progress if the worst violation or their number falls below this part of the
#: least so far, or if more limits are active than ever [–]
PROGRESS = 0.8


class SolvableSubproblem(Protocol):
    """The problem of a working set, without limits."""

    def solve(self, accuracy: Accuracy, last: Array | None) -> DualAnswer:
        """The minimiser; ``last`` is that of the last working set, shape (V,)."""


@dataclass(frozen=True)
class LimitedProblem(abc.ABC):
    """A problem with limits: a program of one field and no other unknowns.

    Where it has others (`field_pair`), what has limits is derived from them.

    Attributes:
        program: The program.
        limits: Its limits.
        links_along_spokes: Whether links are between neighbours of a field, not between
            two fields.
    """

    program: Program
    limits: SpokeLimits = field(repr=False)
    links_along_spokes: ClassVar[bool] = True

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of the grid of every field, (n_r, n_θ, n_z)."""
        return self.program.laplace.grid.shape

    @property
    def alone(self) -> Mask | bool:
        """Unknowns that a row of their own pulls to a value: soft values, (V,)."""
        return ~self.program.laplace.free

    @abc.abstractmethod
    def subproblem(self, active: WorkingSet) -> SolvableSubproblem:
        """The problem of a working set."""

    def limited(self, x: Array) -> Array:
        """What has limits, shape (V,), from all unknowns, shape (n,)."""
        return x[: len(self.limits.lower)]

    def variables(self, p: Array) -> Array:
        """All unknowns of the program, shape (n,)."""
        return p

    def duals(self, x: Array | None, signs: Multipliers) -> Duals:
        """Multipliers by name.

        Args:
            x: All unknowns, shape (n,); None where the limits alone count.
            signs: Multipliers of the limits.
        """
        return self.limits.duals(signs)

    def start(self, x: Array, duals: Duals) -> tuple[Array, WorkingSet]:
        """What has limits, and the working set of the limits that have multipliers."""
        p = self.limited(x)
        active = WorkingSet.empty(len(p))
        if duals.bounds is not None:
            active.bounds[:] = np.sign(self.limited(duals.bounds))
        for name, (at, _, _) in self.limits.links.items():
            if name in duals.rows:
                active.links[at] |= duals.rows[name] != 0.0
        return p, active

    def objective(self, p: Array) -> float:
        """The objective."""
        return self.program.objective(p)

    def gradient(self, p: Array) -> Array:
        """Gradient of the objective, shape (V,)."""
        return np.add(*self.program.gradient(p))

    def predicted(
        self, active: WorkingSet, p: Array, signs: Multipliers
    ) -> WorkingSet | None:
        """The next working set by a model of the field's response to multipliers.

        Args:
            active: The working set, without links.
            p: Its minimiser, shape (V,).
            signs: Its multipliers.

        Returns:
            The next one; None if there is no model or nothing changes.
        """
        return None


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
        start: tuple[Array, WorkingSet] | None,
        tolerance: float,
        accuracy: Accuracy,
    ) -> None:
        """Set up the initial state; arguments are those of `primal_dual_active_set`."""
        self.problem, self.limits = problem, problem.limits.without_implied()
        self.rtol, self._tolerance = accuracy.rtol, tolerance
        self._deadline = accuracy.deadline
        size = len(self.limits.lower)
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
        enough = self.sets == options.MAX_WORKING_SETS
        return self.settled or self.late or enough

    def predicted(self, found: Violations) -> WorkingSet | None:
        """The working set that a model of the bounds predicts; None without one.

        Args:
            found: The KKT violations of the last working set.
        """
        if self.active.links.any() or (found.links > 0.0).any():
            return None
        return self.problem.predicted(self.active, self.p, self.signs)

    def solve(self, active: WorkingSet, rtol: float) -> Violations:
        """Solve a working set's subproblem.

        Args:
            active: The working set.
            rtol: Relative residual of its dual [–].

        Returns:
            Its KKT violations.
        """
        if self._subproblem is None or active.differs(self.active):
            self._subproblem = None  # freed before the next one is allocated
            self._subproblem, self.active = self.problem.subproblem(active), active
        last = rtol == self.rtol
        field_rtol = RTOL if last else max(RTOL, options.FIELD_ACCURACY * rtol)
        accuracy = Accuracy(rtol, field_rtol, self._deadline)
        answer = self._subproblem.solve(accuracy, self._p)
        self._p = p = answer.p
        self.sets, self.steps = self.sets + 1, self.steps + answer.steps
        self.late = accuracy.late
        gradient = self.problem.gradient(p)
        self.signs = signs = multipliers(self.limits, active, gradient)
        self.multipliers = right_signs(self.limits, active, signs)
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


def primal_dual_active_set(
    problem: LimitedProblem,
    start: tuple[Array, WorkingSet] | None,
    tolerance: float,
    accuracy: Accuracy,
) -> ActiveSetIteration:
    """Find the minimiser and its working set.

    Args:
        problem: The problem.
        start: A field, (V,), and the initial working set; None for an empty one.
        tolerance: KKT tolerance [–].
        accuracy: Accuracy of the final working set.

    Returns:
        The final state of the iteration.
    """
    iteration = ActiveSetIteration(problem, start, tolerance, accuracy)
    progress, safeguard = _Progress(), _Safeguard()
    rtol = options.LOOSEST_SUBPROBLEM
    if accuracy.rtol < DUAL_MARGIN * tolerance and start is not None:
        rtol = accuracy.rtol  # the start is an answer that was not accurate enough
    found = iteration.solve(iteration.active, rtol)
    while not iteration.over:
        active = iteration.active
        if found.count == 0 or (progress.stalled and rtol > accuracy.rtol):
            rtol = accuracy.rtol
        elif progress.stalled:
            height = problem.objective(iteration.p)
            chosen = _chosen(problem, found, active)
            active = safeguard.following(iteration.limits, active, chosen, height)
        else:
            progress.note(found, active)
            rtol = _rough(found, accuracy)
            predicted = iteration.predicted(found)
            if predicted is None:
                chosen = _chosen(problem, found, active)
                predicted = chosen.pivoted(iteration.limits, active)
            active = predicted
        found = iteration.solve(active, rtol)
    return iteration


def _rough(found: Violations, accuracy: Accuracy) -> float:
    """Relative residual for a working set that is not expected to be the last."""
    rtol = max(options.SUBPROBLEM_ACCURACY * found.worst, accuracy.rtol)
    return min(rtol, options.LOOSEST_SUBPROBLEM)


class _Progress:
    """Record of the progress of the iteration."""

    def __init__(self) -> None:
        self._left = options.PATIENCE
        self._worst, self._fewest, self._most = np.inf, np.inf, 0

    @property
    def stalled(self) -> bool:
        """Whether there was no progress for too long."""
        return self._left == 0

    def note(self, found: Violations, active: WorkingSet) -> None:
        """Record the KKT violations of a working set."""
        better = found.worst < PROGRESS * self._worst
        better |= found.count < PROGRESS * self._fewest
        better |= active.count > self._most  # which cannot go on in a cycle
        self._left = options.PATIENCE if better else self._left - 1
        self._worst = min(self._worst, found.worst)
        self._fewest = min(self._fewest, found.count)
        self._most = max(self._most, active.count)


class _Safeguard:
    """Changes of the working set that cannot cycle."""

    def __init__(self) -> None:
        self._height = -np.inf
        self._last: tuple[WorkingSet, Violations] | None = None

    def following(
        self,
        limits: SpokeLimits,
        active: WorkingSet,
        found: Violations,
        height: float,
    ) -> WorkingSet:
        """The next working set.

        Args:
            limits: The limits.
            active: The working set.
            found: Its KKT violations to be changed.
            height: Its minimum of the objective.
        """
        backwards = found.among(active.bounds != 0, active.links)
        if backwards.count:
            return backwards.pivoted(limits, active)
        # adding a single limit cannot fail except by rounding
        if self._last is None or height > self._height or self._last[1].count == 1:
            self._height, self._last = height, (active, found)
        else:
            self._last = self._last[0], self._last[1].worse_half()
        return self._last[1].pivoted(limits, self._last[0])


def _chosen(
    problem: LimitedProblem, found: Violations, active: WorkingSet
) -> Violations:
    """The limits to change: all wrong signs, and some violated limits."""
    bounds = np.maximum(found.bounds, 0.0).reshape(-1, *problem.shape)
    links = np.maximum(found.links, 0.0).reshape(-1, *problem.shape)
    joining = _strong(links) if problem.links_along_spokes else _peak(links)
    return found.among(
        (active.bounds != 0) | problem.alone | _peak(bounds).reshape(-1),
        active.links | joining.reshape(-1),
    )


def _strong(values: Array) -> Mask:
    """Where sizes, (fields, n_r, n_θ, n_z), exceed the share of order constraints."""
    share = options.SHARE * min(1.0, 10.0 * float(values.max()))
    size = (1, *[2 * options.NEIGHBOURHOOD + 1] * 3)
    worst = maximum_filter(values, size, mode=("nearest", "nearest", "wrap", "nearest"))
    return np.asarray((values > 0.0) & (values >= share * worst))


def _peak(values: Array) -> Mask:
    """Where sizes, (fields, n_r, n_θ, n_z), are not below those of any neighbour."""
    peak = values > 0.0
    peak[:, 1:] &= values[:, 1:] >= values[:, :-1]
    peak[:, :-1] &= values[:, :-1] >= values[:, 1:]
    for shift in (1, -1):
        peak &= values >= np.roll(values, shift, axis=2)
    peak[..., 1:] &= values[..., 1:] >= values[..., :-1]
    peak[..., :-1] &= values[..., :-1] >= values[..., 1:]
    return np.asarray(peak)
