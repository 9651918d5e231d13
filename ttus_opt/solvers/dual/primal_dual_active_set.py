"""The primal-dual active-set method, safeguarded.

For each working set the problem without limits is solved. Active limits whose
multiplier has the wrong sign leave the working set, all at once (block pivoting: Júdice
and Pires, Comput. Oper. Res. 21, 1994; Bergounioux, Ito and Kunisch, SIAM J. Control
Optim. 37, 1999). Which of the violated limits join it depends on what they hold:

- a value: where a prior of second order holds a field, few points of contact hold a
  whole region away from its bound. The peaks of the violation join, as in Remez'
  algorithm. With all of a region the active regions shrink by one voxel at a time, in
  50 working sets and more; with peaks it takes 10 to 20. Where few of those that joined
  have the wrong sign in the end, as of a second field that lies on its bound all over
  a patch of skin, what comes near the peaks in size joins too: half as many;
- a value of a voxel that a row of its own draws to another (a soft boundary value): all
  that are violated join, as what is held there holds no region. With peaks of a free
  surface it takes three times as many working sets;
- a slope along spokes: active order constraints fill volumes in the end. All that is
  violated by a share of the worst around it joins, and the less violation is left the
  smaller a share will do: by peaks alone a volume grows by one layer a working set.

Where a problem has a model of how its field answers to multipliers (`touched_limits`,
`soft_values`), and bounds are all that is violated, the model says which of them come
next: a second field on its bound over a patch of skin takes 3 to 5 working sets in
place of 15, a free surface 3 in place of 7.

Changing all at once is fast but may cycle. The safeguard then lets violated limits join
a working set without wrong signs only, as in Lawson and Hanson's method. Such a set
holds the minimum over its limits as inequalities, which can only rise with every limit
that joins: where it has not risen fewer were to join, and no set without wrong signs
comes twice.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter

from ttus_opt.arrays import Array, Mask
from ttus_opt.solvers.dual.active_set import ActiveSetIteration, LimitedProblem
from ttus_opt.solvers.dual.limits import SpokeLimits
from ttus_opt.solvers.dual.optimality import Violations
from ttus_opt.solvers.dual.options import Accuracy, DualOptions
from ttus_opt.solvers.dual.working_set import WorkingSet

#: Wrong signs over the bounds that joined last: above the one only larger violations
#: join from then on, by the factor after it, below the other smaller ones as well [–]
MANY_WRONG, STRICTER = 0.25, 0.7
FEW_WRONG, LAXER = 0.1, 0.75

#: A predicted working set is solved to the end where it differs in this share [–]
FEW = 0.15

#: By how much more exactly a predicted set is solved where the last left no fewer
#: violations: its prediction may have been no better than its accuracy [–]
TIGHTER = 1e-2

#: Below this part of the worst violation of all none joins but peaks [–]
FAR = 0.1


def primal_dual_active_set(
    problem: LimitedProblem,
    limits: SpokeLimits,
    start: tuple[Array, WorkingSet] | None,
    tolerance: float,
    accuracy: Accuracy,
) -> ActiveSetIteration:
    """Find the minimiser and its working set.

    Args:
        problem: Its subproblems, its gradient and what its links hold.
        limits: Its limits.
        start: A field, (V,), and the working set to begin with; None for no limit
            active.
        tolerance: KKT tolerance [–].
        accuracy: Of the last working set.

    Returns:
        Where the iteration ended.
    """
    options = problem.options
    iteration = ActiveSetIteration(problem, limits, start, tolerance, accuracy)
    progress, safeguard, choice = _Progress(options), _Safeguard(), _Choice(problem)
    rtol, rough = options.loosest_subproblem, options.predicted_subproblem
    if accuracy.rtol < options.dual_margin * tolerance and start is not None:
        rtol = accuracy.rtol  # the start is an answer that was not exact enough
    found, fewest = iteration.solve(iteration.active, rtol), len(limits.lower)
    while not iteration.over:
        active = iteration.active
        if found.count >= fewest:  # as exactly as before it would lead back there
            rough = max(TIGHTER * rough, accuracy.rtol)
        fewest = min(found.count, fewest)
        if found.count == 0 or (progress.stalled and rtol > accuracy.rtol):
            rtol = accuracy.rtol
        elif progress.stalled:
            height = problem.objective(iteration.p)
            chosen = choice.peaks(found, active)
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
            chosen = choice.many(found, active)
            active = chosen.pivoted(iteration.limits, active)
        found = iteration.solve(active, rtol)
    return iteration


def _rough(found: Violations, accuracy: Accuracy, options: DualOptions) -> float:
    """How exactly a working set is solved that is not thought to be the last."""
    rtol = max(options.subproblem_accuracy * found.worst, accuracy.rtol)
    return min(rtol, options.loosest_subproblem)


class _Progress:
    """Whether the iteration still gets anywhere."""

    def __init__(self, options: DualOptions) -> None:
        self._options, self._left = options, options.patience
        self._worst, self._fewest, self._most = np.inf, np.inf, 0

    @property
    def stalled(self) -> bool:
        """Whether patience is at its end."""
        return self._left == 0

    def note(self, found: Violations, active: WorkingSet) -> None:
        """Take in the KKT violations of a working set."""
        part = self._options.progress
        better = found.worst < part * self._worst
        better |= found.count < part * self._fewest
        better |= active.count > self._most  # a cycle does not grow
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
            found: Its KKT violations that are to be mended.
            height: Its minimum.
        """
        backwards = found.among(active.bounds != 0, active.links)
        if backwards.count:
            return backwards.pivoted(limits, active)
        # a single one that was missing cannot fail, but for rounding
        if self._last is None or height > self._height or self._last[1].count == 1:
            self._height, self._last = height, (active, found)
        else:
            self._last = self._last[0], self._last[1].worse_half()
        return self._last[1].pivoted(limits, self._last[0])


class _Choice:
    """The KKT violations to mend: all wrong signs, and some violated limits."""

    def __init__(self, problem: LimitedProblem) -> None:
        self._problem, self._options = problem, problem.options
        self._share, self._joined = 1.0, 0

    def peaks(self, found: Violations, active: WorkingSet) -> Violations:
        """Of violated bounds the peaks alone."""
        return self._among(found, active, self._peaks(found))

    def many(self, found: Violations, active: WorkingSet) -> Violations:
        """With the peaks what comes near them in size, as far as that went well."""
        open_ = active.bounds == 0
        self._learn(int(np.count_nonzero(~open_ & (found.bounds > 0.0))))
        joining = self._peaks(found)
        if self._share < 1.0:
            sizes = np.where(open_, np.maximum(found.bounds, 0.0), 0.0)
            fields = sizes.reshape(-1, *self._problem.shape)
            joining |= _near_worst(fields, self._share, self._options).reshape(-1)
        self._joined = int(np.count_nonzero(joining & open_))
        return self._among(found, active, joining)

    def _learn(self, wrong: int) -> None:
        """Ask for a smaller share where few signs are wrong for what has joined."""
        if wrong > MANY_WRONG * self._joined:
            self._share = min(1.0, self._share / STRICTER)
        elif wrong < FEW_WRONG * self._joined:
            self._share = max(self._options.bound_share, LAXER * self._share)

    def _peaks(self, found: Violations) -> Mask:
        """Violated bounds, and wrong signs, that none of their neighbours exceeds."""
        sizes = np.maximum(found.bounds, 0.0).reshape(-1, *self._problem.shape)
        return _peak(sizes).reshape(-1)

    def _among(self, found: Violations, active: WorkingSet, bounds: Mask) -> Violations:
        """Wrong signs, these violated bounds, and the links that join."""
        problem = self._problem
        links = np.maximum(found.links, 0.0).reshape(-1, *problem.shape)
        if problem.links_hold_slopes:
            joining = _strong(links, self._options)
        else:
            joining = _peak(links)
        return found.among(
            (active.bounds != 0) | problem.alone | bounds,
            active.links | joining.reshape(-1),
        )


def _near_worst(values: Array, share: float, options: DualOptions) -> Mask:
    """Where sizes, (fields, n_r, n_θ, n_z), are a share of the worst around."""
    worst = _worst_around(values, options)
    return np.asarray((values > FAR * values.max()) & (values >= share * worst))


def _strong(values: Array, options: DualOptions) -> Mask:
    """Where sizes, shape (fields, n_r, n_θ, n_z), are a share of the worst around."""
    share = options.share * min(1.0, 10.0 * float(values.max()))
    worst = _worst_around(values, options)
    return np.asarray((values > 0.0) & (values >= share * worst))


def _worst_around(values: Array, options: DualOptions) -> Array:
    """The largest size in the neighbourhood, (fields, n_r, n_θ, n_z)."""
    size = (1, *[2 * options.neighbourhood + 1] * 3)
    worst = maximum_filter(values, size, mode=("nearest", "nearest", "wrap", "nearest"))
    return np.asarray(worst)


def _peak(values: Array) -> Mask:
    """Where sizes, (fields, n_r, n_θ, n_z), are not below any of six neighbours'."""
    peak = values > 0.0
    peak[:, 1:] &= values[:, 1:] >= values[:, :-1]
    peak[:, :-1] &= values[:, :-1] >= values[:, 1:]
    for shift in (1, -1):
        peak &= values >= np.roll(values, shift, axis=2)
    peak[..., 1:] &= values[..., 1:] >= values[..., :-1]
    peak[..., :-1] &= values[..., :-1] >= values[..., 1:]
    return np.asarray(peak)
