"""Primal-dual active sets: from face to face until all limits and signs hold.

On each face (`face`) the problem without limits is solved. Limits that are violated
become active, active ones whose multiplier has the wrong sign are let go, all at
once (Bergounioux, Ito and Kunisch, SIAM J. Control Optim. 37, 1999; a semismooth
Newton method). That needs 3 to 20 faces. As nothing proves that it cannot go round
in circles here, changes that stop becoming fewer are made by halves, worst first.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ttus_opt.laplace import RTOL
from ttus_opt.solvers.dual.activity import Activity, no_limits_active
from ttus_opt.solvers.dual.solver import DualAnswer
from ttus_opt.solvers.dual.spoke_limits import SpokeLimits

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Most faces
MAX_FACES = 100

#: Residual of the dual on a face, relative, while more limits change than that [–]
ACCURACY = ((100, 1e-3), (3, 1e-5))

#: Residual of the solves behind the fields of such faces, over that [–]
FINER = 1e-3

#: By how much it is tightened where changes do not become fewer: it may be why [–]
TIGHTER = 1.0 / 30.0

#: Faces without fewer changes before changes are made by halves
PATIENCE = 4

#: Beside -1 and +1 for its bounds: what holds a voxel whose value is given
GIVEN = 2

#: Two pins of a chain agree when they differ by less, relative [–]
SAME = 1e-12

#: What counts as a violation or a wrong sign, over the KKT tolerance [–]
MARGIN = 1e-3


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
        settled: Whether the last face is its own successor.
    """

    p: Array = field(repr=False)
    pull: Array = field(repr=False)
    push: Array = field(repr=False)
    active: Activity
    faces: int
    steps: int
    late: bool
    settled: bool


@dataclass(frozen=True)
class Wrong:
    """By how much limits are violated or multipliers have the wrong sign; > 0 is.

    Attributes:
        pins: By voxel, shape (V,).
        side: Which bound a violation is of, -1 or +1, shape (V,).
        ties: By link, shape (V,).
    """

    pins: Array
    side: NDArray[np.int8]
    ties: Array

    @property
    def count(self) -> int:
        """How many [–]."""
        pins = int(np.count_nonzero(self.pins > 0.0))
        return pins + int(np.count_nonzero(self.ties > 0.0))

    @property
    def worst(self) -> float:
        """The largest of all, relative [–]."""
        return float(max(self.pins.max(), self.ties.max()))


def field_accuracy(accuracy: float, last: float) -> float:
    """Residual of the solves behind the field of a face.

    Args:
        accuracy: Residual of its dual [–].
        last: That of the last face [–].
    """
    return RTOL if accuracy == last else max(RTOL, FINER * accuracy)


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
    limits = limits.without_implied()
    size = len(limits.lower)
    active, guess = no_limits_active(size), None
    if start is not None and len(start[0]) == size:
        guess, active = start[0], _one_pin_each(limits, possible(limits, start[1]))
    accuracy, ceiling = max(rtol, ACCURACY[-1][1]), np.inf
    fewest, patience = np.inf, PATIENCE
    face, solved = problem.face(active), active
    faces, steps, changes, late = 0, 0, -1, False
    while faces < MAX_FACES:
        if active.differs(solved):
            face, solved = problem.face(active), active
        answer = face.solve(
            rtol=accuracy,
            field_rtol=field_accuracy(accuracy, rtol),
            deadline=deadline,
            guess=guess,
        )
        guess = p = answer.p
        faces, steps = faces + 1, steps + answer.steps
        gradient = problem.gradient(p)
        pull, push = multipliers(limits, active, gradient)
        late = deadline is not None and time.perf_counter() > deadline
        wrong = find_wrong(limits, active, p, pull, push, gradient, MARGIN * tolerance)
        changes = wrong.count
        if late or (changes == 0 and accuracy == rtol):
            break
        if changes < 0.8 * fewest:
            fewest, patience = changes, PATIENCE
        else:
            patience -= 1
            ceiling = max(rtol, TIGHTER * min(ceiling, accuracy))
        goals = (goal for many, goal in ACCURACY if changes > many)
        accuracy = min(ceiling, max([rtol, *goals]))
        active = change(limits, active, wrong, all_of_them=patience > 0)
    pull, push = right_signs(limits, active, pull, push)
    settled = changes == 0 and accuracy == rtol and not answer.late
    return FaceAnswer(p, pull, push, active, faces, steps, late, settled)


def multipliers(
    limits: SpokeLimits, active: Activity, gradient: Array
) -> tuple[Array, Array]:
    """Multipliers of active limits that balance the objective's gradient.

    Along a chain the links carry what pulls at the voxels, from its ends to where it
    is pinned; a chain that is not pinned balances by itself.

    Args:
        limits: The limits; at most one pin a chain.
        active: Which are active.
        gradient: Of the objective, shape (V,).

    Returns:
        Pull, of bounds and given values, and push, of links, (V,) each.
    """
    g = limits.by_layer(gradient)
    ties = limits.by_layer(active.ties)
    pinned = limits.by_layer((active.pins != 0) | limits.given)
    inner, outer = g.copy(), g.copy()
    deeper = pinned.copy()  # whether the pin is here or deeper
    for i in range(1, len(g)):
        deeper[i] |= ties[i - 1] & deeper[i - 1]
        inner[i] += np.where(ties[i - 1] & ~deeper[i - 1], inner[i - 1], 0.0)
    for i in range(len(g) - 2, -1, -1):
        outer[i] += np.where(ties[i], outer[i + 1], 0.0)
    push = np.zeros_like(g)
    push[:-1] = np.where(deeper[:-1], -outer[1:], inner[:-1])
    push = np.where(ties, push, 0.0)
    pull = np.where(pinned, -(inner + outer - g), 0.0)
    return pull.reshape(-1), push.reshape(-1)


def find_wrong(
    limits: SpokeLimits,
    active: Activity,
    p: Array,
    pull: Array,
    push: Array,
    gradient: Array,
    margin: float,
) -> Wrong:
    """Violations over the field's size, wrong signs over the gradient's."""
    size = max(float(np.abs(p).max()), np.finfo(float).tiny)
    force = max(float(np.abs(gradient).max()), np.finfo(float).tiny)
    held = (active.pins != 0) | limits.given
    below, above = limits.lower - p, p - limits.upper
    violated = np.where(held, -np.inf, np.maximum(below, above) / size)
    backwards = np.where(active.pins != 0, -pull * active.pins / force, -np.inf)
    growth = np.full(len(p), np.inf)
    growth[: -limits.stride] = p[: -limits.stride] - p[limits.stride :]
    short = np.where(active.ties, -push / force, (limits.least - growth) / size)
    short[~np.isfinite(limits.least)] = -np.inf
    return Wrong(
        np.maximum(violated, backwards) - margin,
        np.where(below > above, -1, 1).astype(np.int8),
        short - margin,
    )


def change(
    limits: SpokeLimits, active: Activity, wrong: Wrong, *, all_of_them: bool
) -> Activity:
    """The next face."""
    pins, ties = wrong.pins > 0.0, wrong.ties > 0.0
    if not (all_of_them or wrong.count < 2):
        sizes = np.concatenate([wrong.pins[pins], wrong.ties[ties]])
        least = float(np.median(sizes))
        pins &= wrong.pins >= least
        ties &= wrong.ties >= least
    released = np.where(active.pins != 0, 0, wrong.side).astype(np.int8)
    changed = replace(
        active,
        pins=np.where(pins, released, active.pins).astype(np.int8),
        ties=active.ties ^ ties,
    )
    return _one_pin_each(limits, changed)


def possible(limits: SpokeLimits, active: Activity) -> Activity:
    """Without limits that are not, or no longer, there."""
    bound = np.where(active.pins < 0, limits.lower, limits.upper)
    there = np.isfinite(bound) & ~limits.given
    pins = np.where(there, active.pins, 0).astype(np.int8)
    return Activity(pins, active.ties & np.isfinite(limits.least))


def _one_pin_each(limits: SpokeLimits, active: Activity) -> Activity:
    """The same with at most one pinned or given voxel a chain.

    Where a chain has a second pin, either one of the two follows from the other and
    the ties between them, or it leaves them slack; then the chain is cut.
    """
    pins, ties = active.pins.copy(), active.ties.copy()
    tied, least = limits.by_layer(ties), limits.by_layer(limits.least)
    held = np.where(limits.given, np.int8(GIVEN), pins)
    values = limits.by_layer(np.where(held > 0, limits.upper, limits.lower))
    kinds = limits.by_layer(held)
    flat = limits.by_layer(np.arange(len(pins)))
    # of the chain so far: what holds it, at which voxel, and its value here
    kind, place, value = kinds[0].copy(), flat[0].copy(), values[0].copy()
    for i in range(1, len(kinds)):
        goes_on = tied[i - 1] & (kind != 0)
        value = np.where(goes_on, value - np.where(goes_on, least[i - 1], 0.0), 0.0)
        kind = np.where(goes_on, kind, 0)
        own = kinds[i]
        both = (kind != 0) & (own != 0)
        slack = np.where(both, value - np.where(own != 0, values[i], 0.0), 0.0)
        near = SAME * (np.abs(value) + np.abs(np.where(both, values[i], 0.0)))
        wide, short = both & (slack > near), both & (slack < -near)
        even = both & ~wide & ~short
        drop_own = (wide & (kind == -1) & (own == -1)) | (even & (own != GIVEN))
        drop_own |= short & (kind != -1) & (own == 1)
        drop_old = (wide & (kind == 1) & (own == 1)) | (short & (kind == -1))
        drop_old |= even & (own == GIVEN) & (kind != GIVEN)
        tied[i - 1] &= ~(both & ~drop_own & ~drop_old)
        pins[flat[i][drop_own]] = 0
        pins[place[drop_old]] = 0
        takes = (own != 0) & ~drop_own
        kind = np.where(takes, own, kind)
        place = np.where(takes, flat[i], place)
        value = np.where(takes, values[i], value)
    return Activity(pins, ties)


def right_signs(
    limits: SpokeLimits, active: Activity, pull: Array, push: Array
) -> tuple[Array, Array]:
    """Multipliers without what is wrong in sign by less than counts."""
    low = np.where(active.pins < 0, np.minimum(pull, 0.0), np.maximum(pull, 0.0))
    return np.where(limits.given, pull, low), np.maximum(push, 0.0)
