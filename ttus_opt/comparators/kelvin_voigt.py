"""Kelvin-Voigt contact: a spring and a damper, by recursive least squares.

    f = K h + B ḣ,   K, B ≥ 0,

per contact patch. At first touch the damper makes the force jump, and when the probe
leaves it would pull: there the force is cut at zero.

Source: N. Diolaiti, C. Melchiorri, S. Stramigioli, Contact impedance estimation for
robotic systems, IEEE Trans. Robotics 21 (2005) 925–935, §II; recursion after L. Ljung,
System Identification (1999), §11.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttus_opt.comparators.patch_law import Estimator, PatchLaw
from ttus_opt.comparators.patch_model import Contact, Sample
from ttus_opt.comparators.recursive_least_squares import RecursiveLeastSquares
from ttus_opt.core.arrays import Array

#: Initial K [N per 10 mm] and B [N s per 10 mm], and their deviations over the noise
FIRST, SPREAD = np.array([5.0, 0.0]), np.array([50.0, 5.0])


@dataclass
class _Linear:
    """f = K h + B ḣ."""

    recursion: RecursiveLeastSquares

    def take(self, sample: Sample, weight: float) -> None:
        regressors = np.array([sample.contact.depth, sample.contact.rate])
        self.recursion.update(regressors, sample.normal_force, weight)

    def as_prior(self) -> _Linear:
        return _Linear(self.recursion.as_prior())

    @property
    def parameters(self) -> Array:
        return np.maximum(self.recursion.estimate, 0.0)


class KelvinVoigt(PatchLaw):
    """Stiffness and damping per patch."""

    name = "kelvin_voigt"
    summary = "spring and damper per patch, recursive least squares (Diolaiti 2005)"

    def _estimator(self) -> Estimator:
        return _Linear(RecursiveLeastSquares.start(FIRST, SPREAD, self.forgetting))

    def _law(self, parameters: Array, contact: Contact) -> float:
        return float(parameters @ [contact.depth, contact.rate])
