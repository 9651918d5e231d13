"""Working sets: which limits are assumed to be active.

Voxels along a spoke whose order constraints are active move as one; they are pooled
into a block, as in the pool-adjacent-violators algorithm (Best and Chakravarti, Math.
Programming 47, 1990). A working set has at most one active bound or given value in a
block: with more, the multipliers would not be unique.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Mask
from ttus_opt.solvers.dual.limits import SpokeLimits

#: Marks a voxel with a given value, beside -1 and +1 for bounds
GIVEN = 2

#: Relative difference below which two bounds of a block count as equal [–]
SAME = 1e-12


@dataclass(frozen=True)
class WorkingSet:
    """Which limits are active.

    Attributes:
        bounds: -1 where the lower bound is active, +1 where the upper one, shape (V,).
        links: Voxels whose order constraint, the link to the next voxel outwards, is
            active, shape (V,).
    """

    bounds: NDArray[np.int8]
    links: Mask

    @classmethod
    def empty(cls, n_voxels: int) -> WorkingSet:
        """No limit is active."""
        return cls(np.zeros(n_voxels, dtype=np.int8), np.zeros(n_voxels, dtype=bool))

    def differs(self, other: WorkingSet) -> int:
        """Number of limits in which two working sets differ [–]."""
        bounds = int(np.count_nonzero(self.bounds != other.bounds))
        return bounds + int(np.count_nonzero(self.links != other.links))

    @property
    def count(self) -> int:
        """Number of active limits [–]."""
        return int(np.count_nonzero(self.bounds) + np.count_nonzero(self.links))

    def existing(self, limits: SpokeLimits) -> WorkingSet:
        """Without limits that do not exist, or no longer."""
        bound = np.where(self.bounds < 0, limits.lower, limits.upper)
        there = np.isfinite(bound) & ~limits.given
        bounds = np.where(there, self.bounds, 0).astype(np.int8)
        return WorkingSet(bounds, self.links & np.isfinite(limits.least))


def one_bound_each(limits: SpokeLimits, active: WorkingSet) -> WorkingSet:
    """The working set with at most one active bound or given value per block.

    If a block has a second bound, either one of the two is implied by the other and the
    links between them and is dropped, or the links are slack and the block is cut.
    """
    bounds, links = active.bounds.copy(), active.links.copy()
    linked, least = limits.by_layer(links), limits.by_layer(limits.least)
    held = np.where(limits.given, np.int8(GIVEN), bounds)
    values = limits.by_layer(np.where(held > 0, limits.upper, limits.lower))
    kinds, places = limits.by_layer(held), limits.by_layer(np.arange(len(bounds)))
    # of the block so far: the kind of its bound, the voxel of that, its value here
    kind, place, value = kinds[0].copy(), places[0].copy(), values[0].copy()
    for i in range(1, len(kinds)):
        goes_on = linked[i - 1] & (kind != 0)
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
        linked[i - 1] &= ~(both & ~drop_own & ~drop_old)
        bounds[places[i][drop_own]] = 0
        bounds[place[drop_old]] = 0
        takes = (own != 0) & ~drop_own
        kind = np.where(takes, own, kind)
        place = np.where(takes, places[i], place)
        value = np.where(takes, values[i], value)
    return WorkingSet(bounds, links)
