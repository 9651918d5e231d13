"""Exchange of active limits: from few to as many as are needed.

Where a prior of second order holds a field, few points of contact hold a whole region
away from its bound: a violated region needs a limit where it is violated worst, hardly
ever everywhere. To make all of it active (`active_set`) gives faces whose active
regions shrink by one voxel at a time, 50 and more of them; to begin with none and to
add the peaks of what is violated, as Remez' exchange does, needs 10 to 20.

To let go of wrong signs and to add peaks at once is fast but may go round in circles.
Where it does, peaks are added only to a face without wrong signs, as in Lawson and
Hanson's method. Such a face is the minimum over its limits as inequalities, which with
every limit that was missing can only rise: where it has not risen fewer were to be
added, and no face without wrong signs comes twice.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ttus_opt.solvers.dual.activity import Activity
from ttus_opt.solvers.dual.face_walk import FaceAnswer, FaceWalk, LimitedProblem
from ttus_opt.solvers.dual.optimality import Wrong, change
from ttus_opt.solvers.dual.spoke_limits import SpokeLimits

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Residual of a face's dual over its worst violation, and at most, relative [–]
ACCURACY, LOOSEST = 1e-2, 1e-3

#: Faces that are better in nothing, the worst limit, the number of wrong ones or that
#: of active ones, before the exchange goes carefully
PATIENCE = 5


def exchange(
    problem: LimitedProblem,
    limits: SpokeLimits,
    shape: tuple[int, int, int],
    start: tuple[Array, Activity] | None = None,
    *,
    tolerance: float,
    rtol: float,
    deadline: float | None,
) -> FaceAnswer:
    """Find the face on which the minimiser lies, and the minimiser.

    Args:
        problem: Its faces, and its gradient, which multipliers come from.
        limits: Its limits.
        shape: Of the grid on which every field lies, (n_r, n_θ, n_z).
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
            peaks = _peaks(wrong, active, shape)
            active = carefully.next(walk.limits, active, peaks, height)
        else:
            better = wrong.worst < 0.8 * best or wrong.count < 0.8 * fewest
            better |= active.count > most  # circles do not grow
            patience = PATIENCE if better else patience - 1
            best, fewest = min(best, wrong.worst), min(fewest, wrong.count)
            most = max(most, active.count)
            accuracy = min(max(ACCURACY * wrong.worst, rtol), LOOSEST)
            peaks = _peaks(wrong, active, shape)
            active = change(walk.limits, active, peaks, all_of_them=True)
        wrong = walk.solve(active, accuracy)
    return walk.answer()


class _Careful:
    """Exchange that cannot go round in circles."""

    def __init__(self) -> None:
        self._height = -np.inf
        self._last: tuple[Activity, Wrong] | None = None

    def next(
        self, limits: SpokeLimits, active: Activity, peaks: Wrong, height: float
    ) -> Activity:
        """The next face.

        Args:
            limits: The limits.
            active: The face.
            peaks: What is wrong on it.
            height: Its minimum.
        """
        pins, ties = peaks.pins > 0.0, peaks.ties > 0.0
        backwards = pins & (active.pins != 0), ties & active.ties
        if backwards[0].any() or backwards[1].any():
            return change(limits, active, _only(peaks, *backwards), all_of_them=True)
        # a single one that was missing cannot fail, but for rounding
        if self._last is None or height > self._height or self._last[1].count == 1:
            self._height, self._last = height, (active, peaks)
        else:
            self._last = self._last[0], _worse_half(self._last[1])
        return change(limits, *self._last, all_of_them=True)


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


def _peaks(wrong: Wrong, active: Activity, shape: tuple[int, int, int]) -> Wrong:
    """What is wrong, of violations only those at peaks."""
    pins = (active.pins != 0) | _peak(wrong.pins, shape)
    return _only(wrong, pins, active.ties | _peak(wrong.ties, shape))


def _peak(size: Array, shape: tuple[int, int, int]) -> Mask:
    """Where a size is above zero and not below that of any of six neighbours."""
    values = np.maximum(size, 0.0).reshape(-1, *shape)
    peak = values > 0.0
    peak[:, 1:] &= values[:, 1:] >= values[:, :-1]
    peak[:, :-1] &= values[:, :-1] >= values[:, 1:]
    for shift in (1, -1):
        peak &= values >= np.roll(values, shift, axis=2)
    peak[..., 1:] &= values[..., 1:] >= values[..., :-1]
    peak[..., :-1] &= values[..., :-1] >= values[..., 1:]
    return peak.reshape(-1)
