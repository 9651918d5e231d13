"""Eq. 10 with the boundary values as equalities instead of least-squares rows.

min_p ‖(L p - b)_free‖² + λ_f ‖N p - f‖² + λ_τ ‖(W p - τ)/ℓ‖²
s.t.  (p - b)_boundary = 0

Source: Yeung, Black, Salcudean (2025), eq. 10, whose Dirichlet rows are soft.
"""

from ttus_opt.contact.scene import Scene
from ttus_opt.problem.constraints.boundary import HardBoundary
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.terms.laplace import LaplaceTerm
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm


def build(
    scene: Scene,
    force_weight: float = 1e-2,
    torque_weight: float = 1e-2,
    torque_length: float | None = None,
) -> Formulation:
    """Eq. 10 with weights λ_f, λ_τ [–], torque length ℓ [m] and exact boundaries."""
    return Formulation(
        terms=[
            LaplaceTerm(scene),
            ForceTerm(scene, force_weight),
            TorqueTerm(scene, torque_weight, torque_length),
        ],
        constraints=[HardBoundary(scene)],
    )
