"""Plain sum of residuals, Σ r: the objective of auxiliary variables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.problem.terms.penalties.base import Penalty, Slope


@dataclass(frozen=True)
class Linear(Penalty):
    """Σ r; unbounded below, so constraints must bound its residuals."""

    formula = "Σ r"
    quadratic = True

    def value(self, r: Array) -> float:
        """Σ r."""
        return float(r.sum())

    def subgradient(self, r: Array) -> Array:
        """Ones."""
        return np.ones_like(r)

    def admissible(self, g: Array) -> Array:
        """Ones, the only gradient."""
        return np.ones_like(g)

    def conjugate(self, g: Array) -> float:
        """0 at the only gradient."""
        return 0.0

    def in_cvxpy(self, r: Any, cp: Any) -> Any:
        """Σ r."""
        return cp.sum(r)

    def resolvent(self, v: Array, step: float) -> tuple[Array, Slope]:
        """Ones."""
        return np.ones_like(v), Slope(np.zeros_like(v))
