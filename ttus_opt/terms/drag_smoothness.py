"""Prior of the drag field q, ‖L q − m b‖² (design §3, friction).

Measurements tell q only where the probe slid. Where friction is the same everywhere
q = μ p, which satisfies L q = μ b as p satisfies L p = b: between, q is what a mean
friction coefficient m makes of p, and m is found with it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.terms.base import AffineRows, Term

#: Name under which a fitted field carries m
MEAN_FRICTION = "mean_friction_coefficient"


@dataclass(frozen=True)
class DragSmoothnessTerm(Term):
    """Squares of the scaled Laplace rows of q, Dirichlet rows included (soft)."""

    name = "drag_smoothness"
    formula = "‖L q − m b‖²"

    def rows(self) -> AffineRows:
        """L over q, and -b over the mean friction coefficient m."""
        b = self.scene.b
        mean = sp.csr_array(-b[:, None])
        return AffineRows({"q": self.scene.L, "m": mean}, np.zeros(len(b)))

    def parameters(self, values: Mapping[str, NDArray[np.float64]]) -> dict[str, float]:
        """The mean friction coefficient."""
        return {MEAN_FRICTION: float(values["m"][0])}
