"""Eq. 10 with weights that have the same meaning on every grid.

min_p ∫ (ℓ₁²∇²p)² dV/ℓ₁³ + λ_f ‖N p - f‖² + λ_τ ‖(W p - τ)/ℓ‖²
s.t.  (p - b)_boundary = 0

ℓ₁ = 1 cm. With the ``trilinear`` sampling the solution converges under refinement.
Source: eq. 10 of Yeung, Black, Salcudean (2025), its sum over voxels as an integral.
"""

from ttus_opt.contact.scene import Scene
from ttus_opt.problem.constraints.boundary import HardBoundary
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.terms.laplace import VolumeWeightedTerm
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm


def build(
    scene: Scene,
    force_weight: float = 1e-2,
    torque_weight: float = 1e-2,
    torque_length: float | None = None,
) -> Formulation:
    """Weights λ_f, λ_τ [–] and torque length ℓ [m]."""
    return Formulation(
        terms=[
            VolumeWeightedTerm(scene),
            ForceTerm(scene, force_weight),
            TorqueTerm(scene, torque_weight, torque_length),
        ],
        constraints=[HardBoundary(scene)],
    )
