"""Which limits of a field are active: what names a face of its feasible set."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ttus_opt.arrays import Mask


@dataclass(frozen=True)
class Activity:
    """Which limits are active.

    Attributes:
        pins: -1 where the lower bound is, +1 where the upper one is, shape (V,).
        ties: Voxels whose link outwards is, shape (V,).
    """

    pins: NDArray[np.int8]
    ties: Mask

    def differs(self, other: Activity) -> int:
        """In how many limits two activities differ [–]."""
        pins = int(np.count_nonzero(self.pins != other.pins))
        return pins + int(np.count_nonzero(self.ties != other.ties))

    @property
    def count(self) -> int:
        """Active limits [–]."""
        return int(np.count_nonzero(self.pins) + np.count_nonzero(self.ties))


def no_limits_active(n_voxels: int) -> Activity:
    """The face that is the whole problem."""
    return Activity(np.zeros(n_voxels, dtype=np.int8), np.zeros(n_voxels, dtype=bool))
