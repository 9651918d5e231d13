"""Smoothness of the drag field q, ‖(L q) over free voxels‖² (design §3, friction).

Measurements tell q only where the probe slid; between, q is as smooth as p is. q
shares p's Laplace rows, without boundary values of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttus_opt.terms.base import AffineRows, Term


@dataclass(frozen=True)
class DragSmoothnessTerm(Term):
    """Squares of the scaled Laplace rows of q at free voxels."""

    name = "drag_smoothness"
    formula = "‖L q‖² over free voxels"

    def rows(self) -> AffineRows:
        """Free rows of L over q."""
        free = np.flatnonzero(self.scene.laplace.free)
        return AffineRows({"q": self.scene.L[free]}, np.zeros(len(free)))
