"""A depth profile as the mean, with eq. 10's Laplace prior on the departure from it.

min_p ‖L (p - φ)‖² + λ_f ‖N p - f‖² + λ_τ ‖(W p - τ)/ℓ‖²

φ(d) = Σ_j c_j (d/10 mm)^a_j, c ≥ 0, is a profile like that of `depth_map`, which alone
explains the measured forces best in least squares. It replaces the boundary values:
p = 0 on the skin and p = φ on the inner layer.

Source: eq. 10 of Yeung, Black, Salcudean (2025); a mean by regression and a prior of
the rest as in C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine
Learning (2006), section 2.7.
"""

from ttus_opt.contact.scene import Scene
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.terms.depth_map_estimate import least_squares_profile
from ttus_opt.problem.terms.laplace import LaplaceResidualTerm
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
            LaplaceResidualTerm(scene, profile=least_squares_profile(scene)),
            ForceTerm(scene, force_weight),
            TorqueTerm(scene, torque_weight, torque_length),
        ]
    )
