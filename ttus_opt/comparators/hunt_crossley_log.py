"""Hunt-Crossley contact by one recursion on the logarithm of the force.

    f = K hⁿ + B hⁿ ḣ,   ln f = ln K + n ln h + ln(1 + B ḣ/K) ≈ ln K + n ln h + (B/K) ḣ,

linear in ln K, n and B/K as long as the damping is small against the stiffness, per
contact patch. The force never pulls: 1 + (B/K) ḣ is cut at zero.

Source: A. Haddadi, K. Hashtrudi-Zaad, Real-time identification of Hunt–Crossley dynamic
models of contact environments, IEEE Trans. Robotics 28 (2012) 555–566. The contact law
is K. H. Hunt, F. R. E. Crossley, J. Appl. Mech. 42 (1975) 440–445.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ttus_opt.comparators.patch_law import Estimator, PatchLaw
from ttus_opt.comparators.patch_model import Contact, Sample
from ttus_opt.comparators.recursive_least_squares import RecursiveLeastSquares
from ttus_opt.core.arrays import Array

#: Initial ln K, n and B/K [s/10 mm], and their deviations over the noise of ln f
FIRST, SPREAD = np.array([math.log(5.0), 1.5, 0.0]), np.array([20.0, 5.0, 1.0])

#: Lower limit of the exponent, below which force does not start from zero [–]
LEAST_EXPONENT = 0.5


@dataclass
class _Logarithm:
    """ln f = ln K + n ln h + (B/K) ḣ."""

    recursion: RecursiveLeastSquares

    def take(self, sample: Sample, weight: float) -> None:
        contact = sample.contact
        regressors = np.array([1.0, math.log(contact.depth), contact.rate])
        self.recursion.update(regressors, math.log(sample.normal_force), weight)

    def as_prior(self) -> _Logarithm:
        return _Logarithm(self.recursion.as_prior())

    @property
    def parameters(self) -> Array:
        log_stiffness, exponent, damping = self.recursion.estimate
        return np.array(
            [log_stiffness, max(exponent, LEAST_EXPONENT), max(damping, 0.0)]
        )


class HuntCrossleyLog(PatchLaw):
    """ln K, n and B/K per patch."""

    name = "hunt_crossley_log"
    summary = "Hunt-Crossley per patch, recursion on ln f (Haddadi 2012)"

    def _estimator(self) -> Estimator:
        return _Logarithm(RecursiveLeastSquares.start(FIRST, SPREAD, self.forgetting))

    def _law(self, parameters: Array, contact: Contact) -> float:
        log_stiffness, exponent, damping = parameters
        spring = math.exp(log_stiffness) * contact.depth**exponent
        return float(spring * max(1.0 + damping * contact.rate, 0.0))
