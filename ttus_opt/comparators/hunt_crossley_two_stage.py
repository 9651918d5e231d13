"""Hunt-Crossley contact by two coupled recursions.

    stage 1, n known:      f = hⁿ (K + B ḣ)              for K and B,
    stage 2, K, B known:   ln(f / (K + B ḣ)) = n ln h    for n,

each sample goes through both, per contact patch. The force never pulls: K + B ḣ is cut
at zero.

Source: N. Diolaiti, C. Melchiorri, S. Stramigioli, Contact impedance estimation for
robotic systems, IEEE Trans. Robotics 21 (2005) 925–935, §IV, where the two are shown to
converge when n begins near enough.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ttus_opt.comparators.hunt_crossley_log import LEAST_EXPONENT
from ttus_opt.comparators.patch_law import Estimator, PatchLaw
from ttus_opt.comparators.patch_model import Contact, Sample
from ttus_opt.comparators.recursive_least_squares import RecursiveLeastSquares
from ttus_opt.core.arrays import Array

#: Initial K [N], B [N s/10 mm] and n, and their deviations over the noise
FIRST, SPREAD = np.array([5.0, 0.0]), np.array([50.0, 5.0])
FIRST_EXPONENT, EXPONENT_SPREAD = np.array([1.5]), np.array([5.0])

#: Upper limit of the exponent in the first stage [–]
LARGEST_EXPONENT = 4.0

#: Lower limit of K + B ḣ in the logarithm, over K [–]
LEAST_SHARE = 0.2


@dataclass
class _TwoStages:
    """K and B, then n."""

    linear: RecursiveLeastSquares
    exponent: RecursiveLeastSquares

    @property
    def _n(self) -> float:
        n = float(self.exponent.estimate[0])
        return min(max(n, LEAST_EXPONENT), LARGEST_EXPONENT)

    def take(self, sample: Sample, weight: float) -> None:
        contact, force = sample.contact, sample.normal_force
        power = contact.depth**self._n
        self.linear.update(power * np.array([1.0, contact.rate]), force, weight)
        stiffness, damping = self.parameters[:2]
        if stiffness <= 0.0:
            return
        level = max(stiffness + damping * contact.rate, LEAST_SHARE * stiffness)
        self.exponent.update(
            np.array([math.log(contact.depth)]), math.log(force / level), weight
        )

    def as_prior(self) -> _TwoStages:
        return _TwoStages(self.linear.as_prior(), self.exponent.as_prior())

    @property
    def parameters(self) -> Array:
        return np.append(np.maximum(self.linear.estimate, 0.0), self._n)


class HuntCrossleyTwoStage(PatchLaw):
    """K, B and n per patch."""

    name = "hunt_crossley_two_stage"
    summary = "Hunt-Crossley per patch, two recursions in turn (Diolaiti 2005)"

    def _estimator(self) -> Estimator:
        return _TwoStages(
            RecursiveLeastSquares.start(FIRST, SPREAD, self.forgetting),
            RecursiveLeastSquares.start(
                FIRST_EXPONENT, EXPONENT_SPREAD, self.forgetting
            ),
        )

    def _law(self, parameters: Array, contact: Contact) -> float:
        stiffness, damping, exponent = parameters
        factor = max(stiffness + damping * contact.rate, 0.0)
        return float(factor * contact.depth**exponent)
