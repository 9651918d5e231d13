"""Sum of squares, Σ r²."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.problem.terms.penalties.base import Penalty, Slope


@dataclass(frozen=True)
class Squares(Penalty):
    """Σ r², the penalty of eq. 10."""

    formula = "Σ r²"
    quadratic = True
    smooth = True

    def value(self, r: Array) -> float:
        """Σ r²."""
        return float(r @ r)

    def subgradient(self, r: Array) -> Array:
        """2 r."""
        return 2.0 * r

    def admissible(self, g: Array) -> Array:
        """The multiplier itself: every one is a gradient somewhere."""
        return g

    def conjugate(self, g: Array) -> float:
        """‖g‖²/4."""
        return float(g @ g) / 4.0

    def in_cvxpy(self, r: Any, cp: Any) -> Any:
        """Σ r²."""
        return cp.sum_squares(r)

    def resolvent(self, v: Array, step: float) -> tuple[Array, Slope]:
        """Divided by 1 + step/2."""
        factor = 1.0 / (1.0 + 0.5 * step)
        return factor * v, Slope(np.full_like(v, factor))
