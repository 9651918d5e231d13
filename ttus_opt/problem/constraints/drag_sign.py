"""Sign of a drag field: that of the field of which it is a share.

Like p, q is not negative inside, zero on the surface layer, and not positive outside,
so that samples across the surface interpolate through zero.

See docs/method/contact.md, Friction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttus_opt.problem.constraints.base import Bounds, Constraint


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
