"""Eq. 10 with a screened Laplace (Helmholtz) prior.

min_p ‖(L - Δr²κ²) p - b‖² + λ_f ‖N p - f‖² + λ_τ ‖(W p - τ)/ℓ‖²

Source: eq. 10 of Yeung, Black, Salcudean (2025) with ∇²p = κ²p in place of ∇²p = 0.
"""

from ttus_opt.contact.scene import Scene
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.terms.laplace import ScreenedTerm
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm


def build(
    scene: Scene,
    force_weight: float = 1e-2,
    torque_weight: float = 1e-2,
    torque_length: float | None = None,
    screening: float = 10.0,
) -> Formulation:
    """Weights λ_f, λ_τ [–], torque length ℓ [m] and screening κ [1/m]."""
    return Formulation(
        terms=[
            ScreenedTerm(scene, screening=screening),
            ForceTerm(scene, force_weight),
            TorqueTerm(scene, torque_weight, torque_length),
        ]
    )
