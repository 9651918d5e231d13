"""Eq. 10 with Tikhonov's term: the field stays near a reference.

min_p ‖L p - b‖² + α ‖p - p_ref‖²_free + λ_f ‖N p - f‖² + λ_τ ‖(W p - τ)/ℓ‖²

p_ref is the Laplace field L⁻¹b, or zero. Source: eq. 10 of Yeung, Black, Salcudean
(2025); A. N. Tikhonov, Solution of Incorrectly Formulated Problems (1963).
"""

from ttus_opt.contact.scene import Scene
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.terms.departures import TikhonovTerm
from ttus_opt.problem.terms.laplace import LaplaceTerm
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm


def build(
    scene: Scene,
    force_weight: float = 1e-2,
    torque_weight: float = 1e-2,
    torque_length: float | None = None,
    ridge: float = 1e-5,
    reference: str = "laplace",
) -> Formulation:
    """Weights λ_f, λ_τ, α [–], length ℓ [m]; reference "laplace" or "zero"."""
    return Formulation(
        terms=[
            LaplaceTerm(scene),
            TikhonovTerm(scene, ridge, reference),
            ForceTerm(scene, force_weight),
            TorqueTerm(scene, torque_weight, torque_length),
        ]
    )
