"""Recursive least squares with forgetting for y = xᵀ φ.

    k = P x / (λ/w + xᵀ P x),   φ ← φ + k (y − xᵀ φ),   P ← (P − k xᵀ P)/λ,

for a sample of weight w. Without forgetting, λ = 1, it is least squares with the prior
information P₀⁻¹ about φ₀.

Source: L. Ljung, System Identification: Theory for the User, 2nd ed. (1999), §11.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttus_opt.core.arrays import Array

#: Weight of a patch's initial estimate, in samples [–]
PRIOR_SAMPLES = 10.0


@dataclass
class RecursiveLeastSquares:
    """State of the recursion.

    Attributes:
        estimate: φ, shape (n,).
        covariance: P, over the noise's variance, shape (n, n).
        forgetting: λ, in (0, 1] [–].
        samples: Number of samples, by weight [–].
    """

    estimate: Array
    covariance: Array
    forgetting: float = 1.0
    samples: float = 0.0

    @classmethod
    def start(
        cls, estimate: Array, spread: Array, forgetting: float
    ) -> RecursiveLeastSquares:
        """The initial state: φ and its deviations over the noise's, shape (n,) each."""
        return cls(
            np.array(estimate, dtype=float),
            np.diag(np.asarray(spread, dtype=float) ** 2),
            forgetting,
        )

    def update(self, x: Array, y: float, weight: float = 1.0) -> None:
        """Update with one sample: regressors x (n,), measurement y and weight [–]."""
        spread = self.covariance @ x
        gain = spread / (self.forgetting / weight + x @ spread)
        self.estimate = self.estimate + gain * (y - x @ self.estimate)
        reduced = self.covariance - np.outer(gain, spread)
        self.covariance = 0.5 * (reduced + reduced.T) / self.forgetting
        self.samples += weight

    def as_prior(self) -> RecursiveLeastSquares:
        """The same estimate with the weight of `PRIOR_SAMPLES`, to start a patch."""
        widened = max(self.samples / PRIOR_SAMPLES, 1.0) * self.covariance
        return RecursiveLeastSquares(self.estimate.copy(), widened, self.forgetting)
