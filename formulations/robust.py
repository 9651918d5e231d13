"""Eq. 10 with Huber's penalty on the forces, which outliers do not distort.

min_p ‖L p - b‖² + λ_f Σ huber(N p - f; δ) + λ_τ ‖(W p - τ)/ℓ‖²

Source: eq. 10 of Yeung, Black, Salcudean (2025); P. J. Huber, Robust Estimation of a
Location Parameter (1964).
"""

from ttus_opt.contact.scene import Scene
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.terms.laplace import LaplaceTerm
from ttus_opt.problem.terms.wrench import RobustForceTerm, TorqueTerm


def build(
    scene: Scene,
    force_weight: float = 1e-2,
    torque_weight: float = 1e-2,
    torque_length: float | None = None,
    limit: float = 0.5,
) -> Formulation:
    """Weights λ_f, λ_τ [–], length ℓ [m] and Huber's limit δ [N]."""
    return Formulation(
        terms=[
            LaplaceTerm(scene),
            RobustForceTerm(scene, force_weight, limit),
            TorqueTerm(scene, torque_weight, torque_length),
        ]
    )
