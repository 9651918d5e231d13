"""Piecewise constant departures from the Laplace field: total variation of p - p₀.

min_p α Σ|D (p - p₀)| + λ_f ‖N p - f‖² + λ_τ ‖(W p - τ)/ℓ‖²
s.t.  (p - b)_boundary = 0

p₀ = L⁻¹b. By default α = 3 λ_f, or 3 λ_τ where λ_f = 0. Source: L. Rudin, S. Osher,
E. Fatemi, Nonlinear Total Variation Based Noise Removal Algorithms (1992), around eq. 8
of Yeung, Black, Salcudean (2025).
"""

from ttus_opt.contact.scene import Scene
from ttus_opt.core.errors import InputError
from ttus_opt.problem.constraints.boundary import HardBoundary
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.terms.departures import TotalVariationTerm
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm


def build(
    scene: Scene,
    force_weight: float = 1e-2,
    torque_weight: float = 1e-2,
    torque_length: float | None = None,
    variation: float | None = None,
    isotropic: bool = False,
) -> Formulation:
    """Weights λ_f, λ_τ, α [–], ℓ [m]; ``isotropic`` uses cones."""
    weight = 3.0 * (force_weight or torque_weight) if variation is None else variation
    if weight == 0.0 < max(force_weight, torque_weight):
        raise InputError(
            "variation must not be 0: nothing else holds an unmeasured field"
        )
    return Formulation(
        terms=[
            TotalVariationTerm(scene, weight, isotropic),
            ForceTerm(scene, force_weight),
            TorqueTerm(scene, torque_weight, torque_length),
        ],
        constraints=[HardBoundary(scene)],
    )
