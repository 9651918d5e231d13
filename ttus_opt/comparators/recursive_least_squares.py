"""Recursive least squares with forgetting: y = xᵀ φ, one sample after the other.

    k = P x / (λ/w + xᵀ P x),   φ ← φ + k (y − xᵀ φ),   P ← (P − k xᵀ P)/λ,

for a sample of the weight w. Without forgetting, λ = 1, it is least squares with the
prior P₀⁻¹ about φ₀.

Source: L. Ljung, System Identification: Theory for the User, 2nd ed. (1999), §11.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttus_opt.arrays import Array

#: Samples of the whole recording that a patch's first estimate is worth [–]
PRIOR_SAMPLES = 10.0


@dataclass
class RecursiveLeastSquares:
    """State of the recursion.

    Attributes:
        estimate: φ, shape (n,).
        covariance: P, up to the noise's variance, shape (n, n).
        forgetting: λ, in (0, 1] [–].
        samples: How many it has seen, by weight [–].
    """

    estimate: Array
    covariance: Array
    forgetting: float = 1.0
    samples: float = 0.0

    @classmethod
    def start(
        cls, estimate: Array, spread: Array, forgetting: float
    ) -> RecursiveLeastSquares:
        """Before the first sample.

        Args:
            estimate: First φ, shape (n,).
            spread: Its deviations, over that of the noise, shape (n,).
            forgetting: λ.
        """
        return cls(
            np.array(estimate, dtype=float),
            np.diag(np.asarray(spread, dtype=float) ** 2),
            forgetting,
        )

    def update(self, x: Array, y: float, weight: float = 1.0) -> None:
        """Take one sample.

        Args:
            x: Regressors, shape (n,).
            y: What was measured.
            weight: 1 for a whole sample [–].
        """
        spread = self.covariance @ x
        gain = spread / (self.forgetting / weight + x @ spread)
        self.estimate = self.estimate + gain * (y - x @ self.estimate)
        reduced = self.covariance - np.outer(gain, spread)
        self.covariance = 0.5 * (reduced + reduced.T) / self.forgetting
        self.samples += weight

    def as_prior(self) -> RecursiveLeastSquares:
        """The same estimate, worth `PRIOR_SAMPLES`: where a patch begins."""
        widened = max(self.samples / PRIOR_SAMPLES, 1.0) * self.covariance
        return RecursiveLeastSquares(self.estimate.copy(), widened, self.forgetting)
