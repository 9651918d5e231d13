"""Laplace prior with measured forces and torques in least squares (paper eq. 10).

min_p ‖L p - b‖² + λ_f ‖N p - f‖² + λ_τ ‖(W p - τ)/ℓ‖²

Source: Yeung, Black, Salcudean, Measurement and Potential Field-Based Patient
Modeling for Model-Mediated Tele-ultrasound (2025); the paper has
λ_f = λ_τ = 1e-4 (`ttus_opt.core.paper`). ℓ makes torque comparable with force;
``torque_length=1`` is the paper's literal form in SI units. ``direction_error=0.2``
divides tangential forces and torques by errors of 0.2 rad of the force besides those of
normal forces (`ttus_opt.problem.terms.part_noise`); the paper's rows have errors alike.
"""

from ttus_opt.contact.scene import Scene
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.terms.laplace import LaplaceTerm
from ttus_opt.problem.terms.part_noise import PartNoise
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm


def build(
    scene: Scene,
    force_weight: float = 1e-2,
    torque_weight: float = 1e-2,
    torque_length: float | None = None,
    direction_error: float | None = None,
) -> Formulation:
    """Eq. 10 with λ_f, λ_τ [–], torque length ℓ [m], error of directions [rad]."""
    noise = PartNoise.of_direction(scene, direction_error)
    return Formulation(
        terms=[
            LaplaceTerm(scene),
            ForceTerm(scene, force_weight, noise=noise),
            TorqueTerm(scene, torque_weight, torque_length, noise=noise),
        ]
    )
