"""Eq. 10 with different conductivities along r, θ and z.

min_p ‖L(k_r, k_θ, k_z) p - b‖² + λ_f ‖N p - f‖² + λ_τ ‖(W p - τ)/ℓ‖²

Source: eq. 10 of Yeung, Black, Salcudean (2025) with ∇·(K ∇p) in place of ∇²p.
"""

from ttus_opt.contact.scene import Scene
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.terms.laplace import AnisotropicTerm
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm


def build(
    scene: Scene,
    force_weight: float = 1e-2,
    torque_weight: float = 1e-2,
    torque_length: float | None = None,
    k_r: float = 1.0,
    k_theta: float = 0.5,
    k_z: float = 0.5,
) -> Formulation:
    """Weights λ_f, λ_τ [–], torque length ℓ [m] and conductivities [–]."""
    return Formulation(
        terms=[
            AnisotropicTerm(scene, conductivities=(k_r, k_theta, k_z)),
            ForceTerm(scene, force_weight),
            TorqueTerm(scene, torque_weight, torque_length),
        ]
    )
