"""Stiffness map: a power law of the depth with stiffness kriged over the surface.

    f = K(s) hᵃ,   K(s) = K₀ (1 + g(s)),

with g a Gaussian process of standard deviation σ and Matérn 3/2 covariance of length ℓ
over the places s of contact. The measured normal forces are Gaussian with covariance

    C = K₀² σ² hᵢᵃ hⱼᵃ k(sᵢ, sⱼ) + σ_n² δᵢⱼ ,

so that a, ℓ, σ and σ_n are chosen by evidence, with weak log-normal priors, and K(s)
follows from the mean of g given the forces (kriging).

Source: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning
(2006), §§2.2, 5.4.1; stiffness maps from palpation by Gaussian processes: P. Chalasani,
L. Wang, R. Roy, N. Simaan, R. H. Taylor, M. Kobilarov, Concurrent nonparametric
estimation of organ geometry and tissue stiffness using continuous adaptive palpation,
ICRA 2016, 4164–4171.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.distance import cdist

from ttus_opt.comparators.patch_model import Contact, PatchModel, Sample
from ttus_opt.core.arrays import Array
from ttus_opt.gaussian.conditioned import ByCovariance, Conditioned
from ttus_opt.gaussian.matern import matern
from ttus_opt.gaussian.posterior_mode import posterior_mode

#: Median and logarithmic deviation of the priors of a, ℓ [m], σ and σ_n [N]
MEDIANS = np.log([1.3, 0.03, 0.4, 0.15])
WIDTHS = np.array([0.25, 0.3, 0.5, 1.0])

#: Most samples, evenly thinned: the evidence costs their number cubed [–]
MOST_SAMPLES = 300

#: Lower limit of σ_n over the root-mean-square force [–]
LEAST_NOISE = 1e-4


@dataclass(frozen=True)
class PowerLaw:
    """Hyperparameters chosen by evidence.

    Attributes:
        exponent: a [–].
        length: ℓ [m].
        deviation: σ [–].
        noise: σ_n [N].
    """

    exponent: float
    length: float
    deviation: float
    noise: float


@dataclass(frozen=True)
class Palpation:
    """Depths, places and normal forces of n contacts.

    Attributes:
        depth: h, shape (n,) [10 mm].
        place: s, shape (n, 3) [m].
        force: Shape (n,) [N].
    """

    depth: Array = field(repr=False)
    place: Array = field(repr=False)
    force: Array = field(repr=False)

    def base(self, exponent: float) -> tuple[Array, float]:
        """The powers of the depths, and K₀ by least squares."""
        power = self.depth**exponent
        return power, float(power @ self.force) / float(power @ power)

    def given(self, law: PowerLaw) -> Conditioned:
        """The forces less K₀ hᵃ, of covariance C [N]."""
        power, stiffness = self.base(law.exponent)
        scaled = stiffness * law.deviation * power
        cov = (
            scaled[:, None] * scaled * matern(cdist(self.place, self.place), law.length)
        )
        cov[np.diag_indices_from(cov)] += law.noise**2
        return ByCovariance.of(cov, self.force - stiffness * power)


class StiffnessMap(PatchModel):
    """A power law with kriged stiffness.

    Attributes:
        law: The hyperparameters; None before a fit.
        mean_stiffness: K₀, the mean force at a depth of 10 mm [N].
    """

    name = "stiffness_map"
    summary = "power law, stiffness kriged over the surface, by evidence"

    law: PowerLaw | None = None
    mean_stiffness = 0.0

    def parameters(self) -> dict[str, float]:
        """Mean stiffness, exponent, length, deviation and noise."""
        if self.law is None:
            return {}
        return {
            "mean stiffness [N at 10 mm]": self.mean_stiffness,
            "exponent [–]": self.law.exponent,
            "length [m]": self.law.length,
            "deviation [–]": self.law.deviation,
            "noise [N]": self.law.noise,
        }

    def stiffness_at(self, place: Array) -> float:
        """K(s) [N at 10 mm] at a place (3,) on the surface [m]."""
        assert self.law is not None
        near = matern(cdist(place[None], self._places), self.law.length)[0]
        return self.mean_stiffness + float(near @ self._weights)

    def _fit_law(self, samples: list[Sample]) -> None:
        kept = samples[:: -(-len(samples) // MOST_SAMPLES)]
        data = Palpation(
            np.array([sample.contact.depth for sample in kept]),
            np.array([sample.contact.place for sample in kept]),
            np.array([sample.normal_force for sample in kept]),
        )
        law = chosen_law(data)
        power, stiffness = data.base(law.exponent)
        solved = data.given(law).multipliers
        self.law, self.mean_stiffness, self._places = law, stiffness, data.place
        self._weights = (stiffness * law.deviation) ** 2 * power * solved

    def _normal_force(self, contact: Contact) -> float:
        assert self.law is not None
        stiffness = self.stiffness_at(contact.place)
        return float(stiffness * contact.depth**self.law.exponent)


def chosen_law(data: Palpation) -> PowerLaw:
    """The law with the largest evidence times prior."""
    least = LEAST_NOISE * float(np.sqrt(np.mean(data.force**2)))

    def law(steps: Array) -> PowerLaw:
        exponent, length, deviation, noise = np.exp(MEDIANS + WIDTHS * steps)
        return PowerLaw(
            float(exponent), float(length), float(deviation), max(float(noise), least)
        )

    mode = posterior_mode(lambda steps: data.given(law(steps)).log_density, 4, 200)
    return law(mode.steps)
