"""Contact patches: a coarse grid over the surface, with bilinear weights.

A place belongs to the four nodes around it, bilinearly in angle and height, so that
parameters per patch are continuous over the surface.
"""

from __future__ import annotations

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.scan.surface import Surface

#: Patches around the patient, and their height [m]: both about 4 cm
AROUND, HEIGHT = 24, 0.04


class PatchGrid:
    """Nodes around and along the patient."""

    def __init__(self, surface: Surface) -> None:
        self._low, length = float(surface.z[0]), float(np.ptp(surface.z))
        self._along = max(round(length / HEIGHT), 1) + 1
        self._per_metre = (self._along - 1) / length

    @property
    def n_patches(self) -> int:
        """Number of patches [–]."""
        return AROUND * self._along

    def shares(self, place: Array) -> list[tuple[int, float]]:
        """Nodes and weights, which add up to 1, of a place (3,), patient frame [m]."""
        u = np.arctan2(place[1], place[0]) / (2.0 * np.pi) * AROUND
        v = (place[2] - self._low) * self._per_metre
        v = float(min(max(v, 0.0), self._along - 1.0))
        j, k = int(np.floor(u)), min(int(v), self._along - 2)
        a, b = float(u - j), v - k
        corners = (
            (j, k, (1.0 - a) * (1.0 - b)),
            (j, k + 1, (1.0 - a) * b),
            (j + 1, k, a * (1.0 - b)),
            (j + 1, k + 1, a * b),
        )
        return [(j % AROUND * self._along + k, w) for j, k, w in corners if w > 0.0]
