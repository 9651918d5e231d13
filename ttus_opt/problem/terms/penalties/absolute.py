"""Sum of absolute values, Σ |r|: few residuals differ from zero.

Source: R. Tibshirani, Regression Shrinkage and Selection via the Lasso (1996).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.problem.terms.penalties.base import Penalty, Slope, Split


@dataclass(frozen=True)
class Absolute(Penalty):
    """Σ |r|."""

    formula = "Σ |r|"

    @property
    def split(self) -> Split:
        """Min Σ (above + below) over r = above − below."""
        return Split(1.0, squares_rest=False)

    def value(self, r: Array) -> float:
        """Σ |r|."""
        return float(np.abs(r).sum())

    def subgradient(self, r: Array) -> Array:
        """Signs, 0 where a residual is zero."""
        return np.sign(r)

    def admissible(self, g: Array) -> Array:
        """Between −1 and 1."""
        return np.clip(g, -1.0, 1.0)

    def conjugate(self, g: Array) -> float:
        """0 between −1 and 1."""
        return 0.0

    def gauge(self, g: Array) -> float:
        """The largest |g|."""
        return float(np.abs(g).max(initial=0.0))

    def farthest(self, value: float) -> float:
        """Its own value, in one residual."""
        return value

    def in_cvxpy(self, r: Any, cp: Any) -> Any:
        """Σ |r|."""
        return cp.norm1(r)

    def resolvent(self, v: Array, step: float) -> tuple[Array, Slope]:
        """The nearest point between −1 and 1."""
        return np.clip(v, -1.0, 1.0), Slope((np.abs(v) < 1.0).astype(float))
