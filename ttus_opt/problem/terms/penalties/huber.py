"""Huber's penalty: squares of small residuals, absolute values of large ones.

Source: P. J. Huber, Robust Estimation of a Location Parameter (1964).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.problem.terms.penalties.base import Penalty, Slope, Split


@dataclass(frozen=True)
class Huber(Penalty):
    """Σ huber(r; δ): r² up to δ and 2δ|r| − δ² beyond.

    Attributes:
        threshold: δ, the largest squared residual [unit of r].
    """

    threshold: float

    formula = "Σ huber(r; δ)"
    smooth = True

    @property
    def split(self) -> Split:
        """Min ‖r − above + below‖² + 2δ Σ (above + below)."""
        return Split(2.0 * self.threshold, squares_rest=True)

    def value(self, r: Array) -> float:
        """Σ huber(r; δ)."""
        size = np.abs(r)
        small = np.minimum(size, self.threshold)
        return float((small * (2.0 * size - small)).sum())

    def subgradient(self, r: Array) -> Array:
        """Twice r, clipped to ±2δ."""
        return np.asarray(2.0 * np.clip(r, -self.threshold, self.threshold))

    def admissible(self, g: Array) -> Array:
        """Between −2δ and 2δ."""
        return np.clip(g, -2.0 * self.threshold, 2.0 * self.threshold)

    def conjugate(self, g: Array) -> float:
        """‖g‖²/4."""
        return float(g @ g) / 4.0

    def gauge(self, g: Array) -> float:
        """The largest |g| over 2δ."""
        return float(np.abs(g).max(initial=0.0)) / (2.0 * self.threshold)

    def farthest(self, value: float) -> float:
        """From Fenchel's inequality with 2δ r/‖r‖: φ(r) ≥ 2δ‖r‖ − δ²."""
        return 0.5 * (value / self.threshold + self.threshold)

    def in_cvxpy(self, r: Any, cp: Any) -> Any:
        """Σ huber(r; δ)."""
        return cp.sum(cp.huber(r, self.threshold))

    def resolvent(self, v: Array, step: float) -> tuple[Array, Slope]:
        """Divided by 1 + step/2 and clipped to ±2δ."""
        factor, most = 1.0 / (1.0 + 0.5 * step), 2.0 * self.threshold
        g = factor * v
        return np.clip(g, -most, most), Slope(np.where(np.abs(g) < most, factor, 0.0))
