"""Exchange of active limits, from face to face until all limits and signs hold.

On each face the problem without limits is solved. Active limits whose multiplier has
the wrong sign are let go, all at once (Bergounioux, Ito and Kunisch, SIAM J. Control
Optim. 37, 1999). What becomes active of all that is violated depends on what it holds:

- a value: where a prior of second order holds a field, few points of contact hold a
  whole region away from its bound. Only the peaks of what is violated become active,
  as in Remez' exchange. To add all of a region gives faces whose active regions shrink
  by one voxel at a time, 50 and more of them; with peaks it takes 10 to 20;
- a slope along spokes: what is active at last fills volumes. All that is violated by a
  share of the worst around it becomes active, and the less there is left to mend the
  smaller a share will do: by peaks alone a volume grows by one layer a face.

To let go of wrong signs and to add peaks at once is fast but may go round in circles.
Where it does, peaks are added only to a face without wrong signs, as in Lawson and
Hanson's method. Such a face is the minimum over its limits as inequalities, which with
every limit that was missing can only rise: where it has not risen fewer were to be
added, and no face without wrong signs comes twice.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter

from ttus_opt.arrays import Array, Mask
from ttus_opt.solvers.dual.active_set import FaceAnswer, FaceWalk, LimitedProblem
from ttus_opt.solvers.dual.activity import Activity
from ttus_opt.solvers.dual.limits import SpokeLimits
from ttus_opt.solvers.dual.optimality import Wrong, change

#: Residual of a face's dual over its worst violation, and at most, relative [–]
ACCURACY, LOOSEST = 1e-2, 1e-3

#: A slope becomes active where it is violated by this share of the worst so many voxels
#: around it; by less where the worst violation of all, relative, is less than a tenth
SHARE, AROUND = 0.3, 4

#: So does a link of two fields, but from below that worst violation on only: by then
#: what contact presses apart is settled, and sheets of voxels barely touch [–]
SHARE_OF_PAIR, AROUND_PAIR, SETTLED = 0.8, 1, 1e-3

#: Faces that are better in nothing, the worst limit, the number of wrong ones or that
#: of active ones, before the exchange goes carefully
PATIENCE = 5


def exchange(
    problem: LimitedProblem,
    limits: SpokeLimits,
    start: tuple[Array, Activity] | None = None,
    *,
    tolerance: float,
    rtol: float,
    deadline: float | None,
) -> FaceAnswer:
    """Find the face on which the minimiser lies, and the minimiser.

    Args:
        problem: Its faces, its gradient, which multipliers come from, and what its
            links hold.
        limits: Its limits.
        start: A field, (V,), and the face to begin with; None for no limit active.
        tolerance: KKT tolerance [–].
        rtol: Residual of the dual on the last face, relative [–].
        deadline: `time.perf_counter` at which to stop; None for never [s].
    """
    walk = FaceWalk(
        problem, limits, start, tolerance=tolerance, rtol=rtol, deadline=deadline
    )
    accuracy, best, fewest, patience = LOOSEST, np.inf, np.inf, PATIENCE
    most, carefully = 0, _Careful()
    wrong = walk.solve(walk.active, accuracy)
    while not walk.over:
        active = walk.active
        if wrong.count == 0 or (patience == 0 and accuracy > rtol):
            accuracy = rtol
        elif patience == 0:
            height = problem.objective(walk.p)
            chosen = _chosen(wrong, active, problem)
            active = carefully.next(walk.limits, active, chosen, height)
        else:
            better = wrong.worst < 0.8 * best or wrong.count < 0.8 * fewest
            better |= active.count > most  # circles do not grow
            patience = PATIENCE if better else patience - 1
            best, fewest = min(best, wrong.worst), min(fewest, wrong.count)
            most = max(most, active.count)
            accuracy = min(max(ACCURACY * wrong.worst, rtol), LOOSEST)
            chosen = _chosen(wrong, active, problem)
            active = change(walk.limits, active, chosen)
        wrong = walk.solve(active, accuracy)
    return walk.answer()


class _Careful:
    """Exchange that cannot go round in circles."""

    def __init__(self) -> None:
        self._height = -np.inf
        self._last: tuple[Activity, Wrong] | None = None

    def next(
        self, limits: SpokeLimits, active: Activity, wrong: Wrong, height: float
    ) -> Activity:
        """The next face.

        Args:
            limits: The limits.
            active: The face.
            wrong: What is to change of what is wrong on it.
            height: Its minimum.
        """
        pins, ties = wrong.pins > 0.0, wrong.ties > 0.0
        backwards = pins & (active.pins != 0), ties & active.ties
        if backwards[0].any() or backwards[1].any():
            return change(limits, active, _only(wrong, *backwards))
        # a single one that was missing cannot fail, but for rounding
        if self._last is None or height > self._height or self._last[1].count == 1:
            self._height, self._last = height, (active, wrong)
        else:
            self._last = self._last[0], _worse_half(self._last[1])
        return change(limits, *self._last)


def _worse_half(wrong: Wrong) -> Wrong:
    """The worse half of what is wrong."""
    sizes = np.concatenate([wrong.pins, wrong.ties])
    kept = np.zeros(len(sizes), dtype=bool)
    kept[np.argsort(sizes)[len(sizes) - wrong.count // 2 :]] = True
    return _only(wrong, *np.split(kept, 2))


def _only(wrong: Wrong, pins: Mask, ties: Mask) -> Wrong:
    """Some of what is wrong."""
    return replace(
        wrong,
        pins=np.where(pins, wrong.pins, -np.inf),
        ties=np.where(ties, wrong.ties, -np.inf),
    )


def _chosen(wrong: Wrong, active: Activity, problem: LimitedProblem) -> Wrong:
    """What is to change of what is wrong: wrong signs, and some violations."""
    pins, ties = (
        np.maximum(size, 0.0).reshape(-1, *problem.shape)
        for size in (wrong.pins, wrong.ties)
    )
    if problem.links_hold_slopes:
        share = min(SHARE, SHARE / 0.1 * float(ties.max()))
        added = _strong(ties, share, AROUND)
    else:
        added = _peak(ties)
        if wrong.worst < SETTLED:
            added |= _strong(ties, SHARE_OF_PAIR, AROUND_PAIR)
    return _only(
        wrong,
        (active.pins != 0) | _peak(pins).reshape(-1),
        active.ties | added.reshape(-1),
    )


def _strong(values: Array, share: float, around: int) -> Mask:
    """Where sizes, shape (fields, n_r, n_θ, n_z), are a share of the worst around."""
    size = (1, *[2 * around + 1] * 3)
    worst = maximum_filter(values, size, mode=("nearest", "nearest", "wrap", "nearest"))
    return np.asarray((values > 0.0) & (values >= share * worst))


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
