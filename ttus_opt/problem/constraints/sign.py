"""Sign of the field: p ≥ 0 inside, p ≤ 0 outside, p = 0 between.

See docs/method/formulations.md, The shelf.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttus_opt.problem.constraints.base import Bounds, Constraint


@dataclass(frozen=True)
class Sign(Constraint):
    """The field pushes out of the patient, never in."""

    name = "sign"
    formula = "p ≥ 0 inside, p ≤ 0 outside"

    def rows(self) -> Bounds:
        """Bounds on p; the surface layer is left to its Dirichlet rows."""
        region = self.scene.voxmap.grid.flatten(self.scene.voxmap.region)
        lower = np.where(region > 0, 0.0, -np.inf)
        upper = np.where(region < 0, 0.0, np.inf)
        return Bounds("p", lower, upper)
