"""What is wrong with limits on a face, and the face to which that leads.

A limit is wrong if it is violated, or if it is active and its multiplier says that
the objective would be less without it. Where nothing is, the minimiser is found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ttus_opt.arrays import Array
from ttus_opt.solvers.dual.activity import Activity
from ttus_opt.solvers.dual.limits import SpokeLimits

#: Beside -1 and +1 for its bounds: what holds a voxel whose value is given
GIVEN = 2

#: Two pins of a chain agree when they differ by less, relative [–]
SAME = 1e-12


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
    doubtful: float,
) -> Wrong:
    """Violations over the field's size, wrong signs over the gradient's.

    Args:
        limits: The limits.
        active: Which are active.
        p: The field, shape (V,).
        pull: As `multipliers` gives it.
        push: As there.
        gradient: Of the objective, shape (V,).
        margin: What is none of either, relative [–].
        doubtful: What is no violation, relative [–].

    Returns:
        By how much they are more than a margin.
    """
    size = max(float(np.abs(p).max()), np.finfo(float).tiny)
    force = max(float(np.abs(gradient).max()), np.finfo(float).tiny)
    held = (active.pins != 0) | limits.given
    below, above = limits.lower - p, p - limits.upper
    violated = np.where(held, -np.inf, np.maximum(below, above) / size - doubtful)
    signs = -pull * active.pins / force - margin
    backwards = np.where(active.pins != 0, signs, -np.inf)
    growth = np.full(len(p), np.inf)
    growth[: -limits.stride] = p[: -limits.stride] - p[limits.stride :]
    short = (limits.least - growth) / size - doubtful
    short = np.where(active.ties, -push / force - margin, short)
    short[~np.isfinite(limits.least)] = -np.inf
    return Wrong(
        np.maximum(violated, backwards),
        np.where(below > above, -1, 1).astype(np.int8),
        short,
    )


def change(limits: SpokeLimits, active: Activity, wrong: Wrong) -> Activity:
    """The face to which letting go and taking up all that is wrong leads."""
    pins, ties = wrong.pins > 0.0, wrong.ties > 0.0
    released = np.where(active.pins != 0, 0, wrong.side).astype(np.int8)
    changed = replace(
        active,
        pins=np.where(pins, released, active.pins).astype(np.int8),
        ties=active.ties ^ ties,
    )
    return one_pin_each(limits, changed)


def possible(limits: SpokeLimits, active: Activity) -> Activity:
    """Without limits that are not, or no longer, there."""
    bound = np.where(active.pins < 0, limits.lower, limits.upper)
    there = np.isfinite(bound) & ~limits.given
    pins = np.where(there, active.pins, 0).astype(np.int8)
    return Activity(pins, active.ties & np.isfinite(limits.least))


def one_pin_each(limits: SpokeLimits, active: Activity) -> Activity:
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
