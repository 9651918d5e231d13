"""Primal-dual active sets: from face to face until all limits and signs hold.

On each face (`face`) the problem without limits is solved. Limits that are violated
become active, active ones whose multiplier has the wrong sign are let go, all at
once (Bergounioux, Ito and Kunisch, SIAM J. Control Optim. 37, 1999; a semismooth
Newton method). That needs 3 to 20 faces. As nothing proves that it cannot go round
in circles here, changes that stop becoming fewer are made by halves, worst first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ttus_opt.solvers.dual.activity import Activity
from ttus_opt.solvers.dual.face_walk import FaceAnswer, FaceWalk, LimitedProblem
from ttus_opt.solvers.dual.optimality import change
from ttus_opt.solvers.dual.spoke_limits import SpokeLimits

Array = NDArray[np.float64]

#: Residual of the dual on a face, relative, while more limits change than that [–]
ACCURACY = ((100, 1e-3), (3, 1e-5))

#: By how much it is tightened where changes do not become fewer: it may be why [–]
TIGHTER = 1.0 / 30.0

#: Faces without fewer changes before changes are made by halves
PATIENCE = 4


def search(
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
        problem: Its faces, and its gradient, which multipliers come from.
        limits: Its limits.
        start: A field, (V,), and the face to begin with; None for no limit active.
        tolerance: KKT tolerance [–].
        rtol: Residual of the dual on the last face, relative [–].
        deadline: `time.perf_counter` at which to stop; None for never [s].
    """
    walk = FaceWalk(
        problem, limits, start, tolerance=tolerance, rtol=rtol, deadline=deadline
    )
    accuracy, ceiling = max(rtol, ACCURACY[-1][1]), np.inf
    fewest, patience = np.inf, PATIENCE
    wrong = walk.solve(walk.active, accuracy)
    while not walk.over:
        if wrong.count < 0.8 * fewest:
            fewest, patience = wrong.count, PATIENCE
        else:
            patience -= 1
            ceiling = max(rtol, TIGHTER * min(ceiling, accuracy))
        goals = (goal for many, goal in ACCURACY if wrong.count > many)
        accuracy = min(ceiling, max([rtol, *goals]))
        active = change(walk.limits, walk.active, wrong, all_of_them=patience > 0)
        wrong = walk.solve(active, accuracy)
    return walk.answer()
