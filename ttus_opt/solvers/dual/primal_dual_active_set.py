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

import numpy as np
from scipy.ndimage import maximum_filter

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.solvers.dual.active_set import ActiveSetIteration, LimitedProblem
from ttus_opt.solvers.dual.limits import SpokeLimits
from ttus_opt.solvers.dual.optimality import Violations
from ttus_opt.solvers.dual.options import Accuracy, DualOptions
from ttus_opt.solvers.dual.working_set import WorkingSet

#: Relative residual of the last dual over the KKT tolerance [–]
DUAL_MARGIN = 1e-2

#: Relative residual of the dual of a predicted working set: the next prediction needs
#: no more [–]
PREDICTED = 1e-2

#: It is progress if the worst violation or their number falls below this part of the
#: least so far, or if more limits are active than ever [–]
PROGRESS = 0.8

#: A predicted working set that changes at most this share of limits is solved fully [–]
FEW = 0.15

#: Factor on the residual of a predicted working set if the last one left no fewer
#: violations: its accuracy may have limited the prediction [–]
TIGHTER = 1e-2


def primal_dual_active_set(
    problem: LimitedProblem,
    limits: SpokeLimits,
    start: tuple[Array, WorkingSet] | None,
    tolerance: float,
    accuracy: Accuracy,
) -> ActiveSetIteration:
    """Find the minimiser and its working set.

    Args:
        problem: The problem.
        limits: Its limits.
        start: A field, (V,), and the initial working set; None for an empty one.
        tolerance: KKT tolerance [–].
        accuracy: Accuracy of the final working set.

    Returns:
        The final state of the iteration.
    """
    options = problem.options
    iteration = ActiveSetIteration(problem, limits, start, tolerance, accuracy)
    progress, safeguard = _Progress(options), _Safeguard()
    rtol, rough = options.loosest_subproblem, PREDICTED
    if accuracy.rtol < DUAL_MARGIN * tolerance and start is not None:
        rtol = accuracy.rtol  # the start is an answer that was not accurate enough
    found, fewest = iteration.solve(iteration.active, rtol), len(limits.lower)
    while not iteration.over:
        active = iteration.active
        if found.count >= fewest:  # the same accuracy would lead back to this set
            rough = max(TIGHTER * rough, accuracy.rtol)
        fewest = min(found.count, fewest)
        if found.count == 0 or (progress.stalled and rtol > accuracy.rtol):
            rtol = accuracy.rtol
        elif progress.stalled:
            height = problem.objective(iteration.p)
            chosen = _chosen(problem, found, active)
            active = safeguard.following(iteration.limits, active, chosen, height)
        elif (predicted := iteration.predicted(found)) is not None:
            progress.note(found, active)
            few = predicted.differs(active) <= FEW * predicted.count
            enough = _rough(found, accuracy, options)
            enough = rough if iteration.predicts_roughly else min(rough, enough)
            rtol = accuracy.rtol if few else enough
            active = predicted
        else:
            progress.note(found, active)
            rtol = _rough(found, accuracy, options)
            chosen = _chosen(problem, found, active)
            active = chosen.pivoted(iteration.limits, active)
        found = iteration.solve(active, rtol)
    return iteration


def _rough(found: Violations, accuracy: Accuracy, options: DualOptions) -> float:
    """Relative residual for a working set that is not expected to be the last."""
    rtol = max(options.subproblem_accuracy * found.worst, accuracy.rtol)
    return min(rtol, options.loosest_subproblem)


class _Progress:
    """Record of the progress of the iteration."""

    def __init__(self, options: DualOptions) -> None:
        self._options, self._left = options, options.patience
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
        self._left = self._options.patience if better else self._left - 1
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
    if problem.links_along_spokes:
        joining = _strong(links, problem.options)
    else:
        joining = _peak(links)
    return found.among(
        (active.bounds != 0) | problem.alone | _peak(bounds).reshape(-1),
        active.links | joining.reshape(-1),
    )


def _strong(values: Array, options: DualOptions) -> Mask:
    """Where sizes, (fields, n_r, n_θ, n_z), exceed the share of order constraints."""
    share = options.share * min(1.0, 10.0 * float(values.max()))
    size = (1, *[2 * options.neighbourhood + 1] * 3)
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
