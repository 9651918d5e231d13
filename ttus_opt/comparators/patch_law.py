"""Contact laws with a few parameters per patch, estimated recursively.

A first recursion over all samples initialises every patch; each patch then continues
with its own samples. Rendering interpolates the parameters between patches. h is the
depth in 10 mm.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Unpack

import numpy as np

from ttus_opt.comparators.base import Given
from ttus_opt.comparators.patch_model import Contact, PatchModel, Sample
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.probe.cylindrical import lattice_shares
from ttus_opt.scan.surface import Surface

#: Weight of a patch's initial estimate, in samples [–]
PRIOR_SAMPLES = 10.0


@dataclass
class RecursiveLeastSquares:
    """Recursive least squares with forgetting for y = xᵀ φ.

        k = P x / (λ/w + xᵀ P x),   φ ← φ + k (y − xᵀ φ),   P ← (P − k xᵀ P)/λ,

    for a sample of weight w. Without forgetting, λ = 1, it is least squares with the
    prior information P₀⁻¹ about φ₀.

    Source: L. Ljung, System Identification: Theory for the User, 2nd ed. (1999), §11.2.

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


Recursions = list[RecursiveLeastSquares]

#: Forgetting factor: after 400 frames the first has two thirds of its weight [–]
FORGETTING = 0.999


#: Patches around the patient, and their height [m]: both about 4 cm
AROUND, HEIGHT = 24, 0.04


class PatchLaw(PatchModel):
    """Recursive estimates per contact patch.

    Attributes:
        forgetting: Factor of the recursions [–].
        patches: Grid of the patches.
        per_patch: Parameters, shape (patches, parameters).
        first: Of every recursion the initial estimate and its deviations over the
            noise.
    """

    first: ClassVar[tuple[tuple[Array, Array], ...]]

    def __init__(
        self, *, forgetting: float = FORGETTING, **given: Unpack[Given]
    ) -> None:
        super().__init__(**given)
        if not (math.isfinite(forgetting) and 0.0 < forgetting <= 1.0):
            raise InputError(f"forgetting must be in (0, 1], got {forgetting}")
        self.forgetting = forgetting
        self.patches = PatchGrid(self.surface)
        self.per_patch = np.zeros((self.patches.n_patches, 0))

    def _fit_law(self, samples: list[Sample]) -> None:
        whole = [
            RecursiveLeastSquares.start(*pair, self.forgetting) for pair in self.first
        ]
        for sample in samples:
            self._take(whole, sample, 1.0)
        by_patch: dict[int, Recursions] = {}
        for sample in samples:
            for patch, share in self.patches.shares(sample.contact.place):
                if patch not in by_patch:
                    by_patch[patch] = [one.as_prior() for one in whole]
                self._take(by_patch[patch], sample, share)
        self.per_patch = np.tile(self._parameters(whole), (self.patches.n_patches, 1))
        for patch, recursions in by_patch.items():
            self.per_patch[patch] = self._parameters(recursions)

    def _normal_force(self, contact: Contact) -> float:
        blend = sum(
            share * self.per_patch[patch]
            for patch, share in self.patches.shares(contact.place)
        )
        return self._law(np.asarray(blend), contact)

    @abstractmethod
    def _take(self, recursions: Recursions, sample: Sample, weight: float) -> None:
        """Update one recursion per pair of `first` with a weighted sample."""

    @abstractmethod
    def _parameters(self, recursions: Recursions) -> Array:
        """The law's parameters by the recursions."""

    @abstractmethod
    def _law(self, parameters: Array, contact: Contact) -> float:
        """The normal force [N]."""


class PatchGrid:
    """Nodes around and along the patient.

    A place belongs to the four nodes around it, bilinearly, so that parameters per
    patch are continuous over the surface.
    """

    def __init__(self, surface: Surface) -> None:
        self._low, self._length = float(surface.z[0]), float(np.ptp(surface.z))
        self._along = max(round(self._length / HEIGHT), 1) + 1

    @property
    def n_patches(self) -> int:
        """Number of patches [–]."""
        return AROUND * self._along

    def shares(self, place: Array) -> list[tuple[int, float]]:
        """Nodes and weights, which add up to 1, of a place (3,), patient frame [m]."""
        theta, along = np.arctan2(place[1], place[0]), (place[2] - self._low)
        corners = lattice_shares(theta, along / self._length, (AROUND, self._along))
        return [(int(node), float(share)) for node, share in corners if share > 0.0]


#: Initial K [N per 10 mm] and B [N s per 10 mm], and their deviations over the noise
LINEAR = np.array([5.0, 0.0]), np.array([50.0, 5.0])


class KelvinVoigt(PatchLaw):
    """Stiffness and damping per patch: f = K h + B ḣ with K, B ≥ 0.

    At first touch the damper makes the force jump, and when the probe leaves it would
    pull: there the force is cut at zero.

    Source: N. Diolaiti, C. Melchiorri, S. Stramigioli, Contact impedance estimation for
    robotic systems, IEEE Trans. Robotics 21 (2005) 925–935, §II.
    """

    name = "kelvin_voigt"
    summary = "spring and damper per patch, recursive least squares (Diolaiti 2005)"

    first = (LINEAR,)

    def _take(self, recursions: Recursions, sample: Sample, weight: float) -> None:
        regressors = np.array([sample.contact.depth, sample.contact.rate])
        recursions[0].update(regressors, sample.normal_force, weight)

    def _parameters(self, recursions: Recursions) -> Array:
        return np.maximum(recursions[0].estimate, 0.0)

    def _law(self, parameters: Array, contact: Contact) -> float:
        return float(parameters @ [contact.depth, contact.rate])


#: Initial ln K, n and B/K [s/10 mm], and their deviations over the noise of ln f
LOGARITHM = np.array([math.log(5.0), 1.5, 0.0]), np.array([20.0, 5.0, 1.0])

#: Lower limit of the exponent, below which force does not start from zero [–]
LEAST_EXPONENT = 0.5


class HuntCrossleyLog(PatchLaw):
    """ln K, n and B/K per patch, by one recursion on the logarithm of the force.

        f = K hⁿ + B hⁿ ḣ,   ln f ≈ ln K + n ln h + (B/K) ḣ,

    as long as the damping is small against the stiffness. The force never pulls:
    1 + (B/K) ḣ is cut at zero.

    Source: A. Haddadi, K. Hashtrudi-Zaad, Real-time identification of Hunt–Crossley
    dynamic models of contact environments, IEEE Trans. Robotics 28 (2012) 555–566. The
    contact law is K. H. Hunt, F. R. E. Crossley, J. Appl. Mech. 42 (1975) 440–445.
    """

    name = "hunt_crossley_log"
    summary = "Hunt-Crossley per patch, recursion on ln f (Haddadi 2012)"

    first = (LOGARITHM,)

    def _take(self, recursions: Recursions, sample: Sample, weight: float) -> None:
        contact = sample.contact
        regressors = np.array([1.0, math.log(contact.depth), contact.rate])
        recursions[0].update(regressors, math.log(sample.normal_force), weight)

    def _parameters(self, recursions: Recursions) -> Array:
        return np.maximum(recursions[0].estimate, [-math.inf, LEAST_EXPONENT, 0.0])

    def _law(self, parameters: Array, contact: Contact) -> float:
        log_stiffness, exponent, damping = parameters
        spring = math.exp(log_stiffness) * contact.depth**exponent
        return float(spring * max(1.0 + damping * contact.rate, 0.0))


#: Initial n, and its deviation over the noise [–]; K and B begin as a spring and damper
EXPONENT = np.array([1.5]), np.array([5.0])

#: Upper limit of the exponent in the first stage [–]
LARGEST_EXPONENT = 4.0

#: Lower limit of K + B ḣ in the logarithm, over K [–]
LEAST_SHARE = 0.2


class HuntCrossleyTwoStage(PatchLaw):
    """K, B and n per patch, by two coupled recursions.

        stage 1, n known:      f = hⁿ (K + B ḣ)              for K and B,
        stage 2, K, B known:   ln(f / (K + B ḣ)) = n ln h    for n,

    each sample goes through both. The force never pulls: K + B ḣ is cut at zero.

    Source: N. Diolaiti et al. (2005), as of `KelvinVoigt`, §IV, where the two are shown
    to converge when n begins near enough.
    """

    name = "hunt_crossley_two_stage"
    summary = "Hunt-Crossley per patch, two recursions in turn (Diolaiti 2005)"

    first = (LINEAR, EXPONENT)

    def _take(self, recursions: Recursions, sample: Sample, weight: float) -> None:
        linear, exponent = recursions
        contact, force = sample.contact, sample.normal_force
        power = contact.depth ** self._parameters(recursions)[2]
        linear.update(power * np.array([1.0, contact.rate]), force, weight)
        stiffness, damping, _ = self._parameters(recursions)
        if stiffness <= 0.0:
            return
        level = max(stiffness + damping * contact.rate, LEAST_SHARE * stiffness)
        exponent.update(
            np.array([math.log(contact.depth)]), math.log(force / level), weight
        )

    def _parameters(self, recursions: Recursions) -> Array:
        linear, exponent = recursions
        n = np.clip(exponent.estimate[0], LEAST_EXPONENT, LARGEST_EXPONENT)
        return np.append(np.maximum(linear.estimate, 0.0), n)

    def _law(self, parameters: Array, contact: Contact) -> float:
        stiffness, damping, exponent = parameters
        factor = max(stiffness + damping * contact.rate, 0.0)
        return float(factor * contact.depth**exponent)
