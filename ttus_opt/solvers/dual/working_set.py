"""Working sets: which limits are taken to be active.

Voxels along a spoke whose order constraints are active move as one; they are pooled
into a block, as in the pool-adjacent-violators algorithm (Best and Chakravarti, Math.
Programming 47, 1990). A working set has at most one active bound or given value in a
block: more would leave multipliers open.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ttus_opt.arrays import Array, IntArray, Mask
from ttus_opt.solvers.dual.limits import SpokeLimits

#: Beside -1 and +1 for its bounds: what holds a voxel whose value is given
GIVEN = 2

#: Two bounds of a block agree when they differ by less, relative [–]
SAME = 1e-12


@dataclass(frozen=True)
class WorkingSet:
    """Which limits are active.

    Attributes:
        bounds: -1 where the lower bound is, +1 where the upper one is, shape (V,).
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
        """In how many limits two working sets differ [–]."""
        bounds = int(np.count_nonzero(self.bounds != other.bounds))
        return bounds + int(np.count_nonzero(self.links != other.links))

    @property
    def count(self) -> int:
        """Active limits [–]."""
        return int(np.count_nonzero(self.bounds) + np.count_nonzero(self.links))

    def existing(self, limits: SpokeLimits) -> WorkingSet:
        """Without limits that are not, or no longer, there."""
        bound = np.where(self.bounds < 0, limits.lower, limits.upper)
        there = np.isfinite(bound) & ~limits.given
        bounds = np.where(there, self.bounds, 0).astype(np.int8)
        return WorkingSet(bounds, self.links & np.isfinite(limits.least))


class _Spokes:
    """What holds the block so far, spoke by spoke, in a sweep from the inside out.

    Attributes:
        kind: -1, +1 or `GIVEN`; 0 where nothing holds it, shape (n_θ·n_z,).
        place: The voxel at which it is held.
        value: The value this gives the layer reached.
    """

    def __init__(self, kind: NDArray[np.int8], place: IntArray, value: Array) -> None:
        self.kind, self.place, self.value = kind.copy(), place.copy(), value.copy()

    def carry(self, linked: Mask, least: Array) -> None:
        """Go one layer outwards."""
        linked = linked & (self.kind != 0)
        step = np.where(linked, least, 0.0)
        self.value = np.where(linked, self.value - step, 0.0)
        self.kind = np.where(linked, self.kind, 0)

    def dropped(self, own: NDArray[np.int8], values: Array) -> tuple[Mask, Mask, Mask]:
        """Where the layer's bound goes, the block's goes, or the block is cut."""
        kind, value = self.kind, self.value
        both = (kind != 0) & (own != 0)
        slack = np.where(both, value - np.where(own != 0, values, 0.0), 0.0)
        near = SAME * (np.abs(value) + np.abs(np.where(both, values, 0.0)))
        wide, short = both & (slack > near), both & (slack < -near)
        even = both & ~wide & ~short
        new = (wide & (kind == -1) & (own == -1)) | (even & (own != GIVEN))
        new |= short & (kind != -1) & (own == 1)
        old = (wide & (kind == 1) & (own == 1)) | (short & (kind == -1))
        old |= even & (own == GIVEN) & (kind != GIVEN)
        return new, old, both & ~new & ~old

    def take(
        self, where: Mask, kind: NDArray[np.int8], place: IntArray, value: Array
    ) -> None:
        """Be held by a layer's own bounds."""
        self.kind = np.where(where, kind, self.kind)
        self.place = np.where(where, place, self.place)
        self.value = np.where(where, value, self.value)


def one_bound_each(limits: SpokeLimits, active: WorkingSet) -> WorkingSet:
    """The same with at most one active bound or given value a block.

    Where a block has a second bound, either one of the two follows from the other and
    the links between them, or it leaves them slack; then the block is cut.
    """
    bounds, links = active.bounds.copy(), active.links.copy()
    linked, least = limits.by_layer(links), limits.by_layer(limits.least)
    held = np.where(limits.given, np.int8(GIVEN), bounds)
    values = limits.by_layer(np.where(held > 0, limits.upper, limits.lower))
    kinds, places = limits.by_layer(held), limits.by_layer(np.arange(len(bounds)))
    block = _Spokes(kinds[0], places[0], values[0])
    for i in range(1, len(kinds)):
        block.carry(linked[i - 1], least[i - 1])
        new, old, cut = block.dropped(kinds[i], values[i])
        linked[i - 1] &= ~cut
        bounds[places[i][new]] = 0
        bounds[block.place[old]] = 0
        block.take((kinds[i] != 0) & ~new, kinds[i], places[i], values[i])
    return WorkingSet(bounds, links)
