"""Sign of a drag field: that of the field it is a share of.

Inside q ≥ 0. The surface layer has p = 0, and outside p ≤ 0 mirrors the inside, so
that a sample between inside and outside goes through zero at the surface: q does as p.

See docs/method.md, Friction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttus_opt.constraints.base import Bounds, Constraint


@dataclass(frozen=True)
class DragSign(Constraint):
    """Drag opposes the motion."""

    name = "drag_sign"
    formula = "q ≥ 0 inside, q = 0 on the surface, q ≤ 0 outside"

    def rows(self) -> Bounds:
        """Bounds on q."""
        region = self.scene.voxmap.grid.flatten(self.scene.voxmap.region)
        lower = np.where(region >= 0, 0.0, -np.inf)
        upper = np.where(region <= 0, 0.0, np.inf)
        return Bounds("q", lower, upper)
