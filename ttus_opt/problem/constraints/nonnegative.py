"""p ≥ 0 inside and on the surface, whose value is free.

See docs/method/formulations.md, The shelf.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttus_opt.problem.constraints.base import Bounds, Constraint


@dataclass(frozen=True)
class NonNegative(Constraint):
    """Touch never pulls: the field is not negative from the surface inwards."""

    name = "nonnegative"
    formula = "p ≥ 0 inside and on the surface"

    def rows(self) -> Bounds:
        """Bounds on p."""
        region = self.scene.voxmap.grid.flatten(self.scene.voxmap.region)
        lower = np.where(region >= 0, 0.0, -np.inf)
        return Bounds("p", lower, np.full(len(region), np.inf))
