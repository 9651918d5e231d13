"""Eq. 10 without p = 0 on the surface, with p ≥ 0 from there inwards.

min_p ‖L p - b‖² without the surface's rows + λ_f ‖N p - f‖² + λ_τ ‖(W p - τ)/ℓ‖²
s.t.  p ≥ 0 inside and on the surface

With p = 0 on the surface a round tip's force grows like depth², that of real tissue
like depth¹ to depth^1.5. Source: eq. 10 of Yeung, Black, Salcudean (2025).
"""

from ttus_opt.contact.scene import Scene
from ttus_opt.problem.constraints.signs import NonNegative
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.terms.laplace import LaplaceFreeSurfaceTerm
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm


def build(
    scene: Scene,
    force_weight: float = 1e-2,
    torque_weight: float = 1e-2,
    torque_length: float | None = None,
    skin: float = 1e-3,
) -> Formulation:
    """Weights λ_f, λ_τ [–], ℓ [m]; ``skin`` is the weight of the surface's rows [–]."""
    return Formulation(
        terms=[
            LaplaceFreeSurfaceTerm(scene, skin=skin),
            ForceTerm(scene, force_weight),
            TorqueTerm(scene, torque_weight, torque_length),
        ],
        constraints=[NonNegative(scene)],
    )
