"""Sum of Euclidean lengths of groups, Σ ‖r_g‖: few groups differ from zero.

Source: M. Yuan, Y. Lin, Model Selection and Estimation in Regression with Grouped
Variables (2006).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.problem.terms.penalties.base import Penalty, Slope


@dataclass(frozen=True)
class Groups(Penalty):
    """Σ ‖r_g‖ over groups of consecutive residuals.

    Attributes:
        size: Residuals per group [–].
    """

    size: int

    formula = "Σ ‖r_g‖ over groups of consecutive rows"

    @property
    def rows_per_group(self) -> int:
        """Residuals per group [–]."""
        return self.size

    def value(self, r: Array) -> float:
        """Σ ‖r_g‖."""
        return float(self._lengths(r).sum())

    def subgradient(self, r: Array) -> Array:
        """Unit vectors along each group, 0 where a group is zero."""
        lengths = np.repeat(self._lengths(r), self.size)
        return np.divide(r, lengths, out=np.zeros_like(r), where=lengths > 0.0)

    def admissible(self, g: Array) -> Array:
        """No group longer than 1."""
        lengths = np.repeat(self._lengths(g), self.size)
        return np.asarray(g / np.maximum(lengths, 1.0))

    def conjugate(self, g: Array) -> float:
        """0 where no group is longer than 1."""
        return 0.0

    def gauge(self, g: Array) -> float:
        """The longest group."""
        return float(self._lengths(g).max(initial=0.0))

    def farthest(self, value: float) -> float:
        """Its own value, in one group."""
        return value

    def in_cvxpy(self, r: Any, cp: Any) -> Any:
        """Σ ‖r_g‖."""
        groups = cp.reshape(r, (r.size // self.size, self.size), order="C")
        return cp.sum(cp.norm(groups, 2, axis=1))

    def resolvent(self, v: Array, step: float) -> tuple[Array, Slope]:
        """The projection onto the unit balls; outside, its slope is tangential."""
        length = np.repeat(self._lengths(v), self.size)
        outside = length > 1.0
        longest = np.maximum(length, 1.0)
        g = v / longest
        return g, Slope(1.0 / longest, np.where(outside, g, 0.0), self.size)

    def _lengths(self, r: Array) -> Array:
        """Euclidean length of every group."""
        return np.asarray(np.linalg.norm(r.reshape(-1, self.size), axis=1))
