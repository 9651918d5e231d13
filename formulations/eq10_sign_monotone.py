"""Eq. 10 with the field's sign and growth with depth.

min_p ‖L p - b‖² + λ_f ‖N p - f‖² + λ_τ ‖(W p - τ)/ℓ‖²
s.t.  p(r) - p(r + Δr) ≥ s Δr inside, p ≥ 0 inside, p ≤ 0 outside

Source: Yeung, Black, Salcudean (2025), eq. 10; force does not decrease with depth.
"""

from ttus_opt.contact.scene import Scene
from ttus_opt.problem.constraints.monotone import Monotone
from ttus_opt.problem.constraints.signs import Sign
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.terms.laplace import LaplaceTerm
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm


def build(
    scene: Scene,
    force_weight: float = 1e-2,
    torque_weight: float = 1e-2,
    torque_length: float | None = None,
    least_slope: float = 0.0,
) -> Formulation:
    """Eq. 10 with weights λ_f, λ_τ [–], length ℓ [m] and least slope s [unit/m]."""
    return Formulation(
        terms=[
            LaplaceTerm(scene),
            ForceTerm(scene, force_weight),
            TorqueTerm(scene, torque_weight, torque_length),
        ],
        constraints=[Sign(scene), Monotone(scene, least_slope)],
    )
