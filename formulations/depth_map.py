"""A depth profile times a random variation over the patient, no Laplace prior.

min_p ‖R (p/φ − 1)‖²/σ² + λ_f ‖Σ_f⁻¹ᐟ² (N p − f)‖² + λ_τ ‖Σ_τ⁻¹ᐟ² (W p − τ)/ℓ‖²

φ(d) = c (d/10 mm)ᵃ is the same profile of the depth d below the surface everywhere;
RᵀR/σ² is the precision of a Gaussian field with a Matérn covariance along the surface
and along the depth. c, a, σ, both lengths and the noise of normal forces, which grows
with the force, are chosen by their evidence unless they are given. Tangential forces
and torques have an error of 0.2 rad besides, and a tracker's error of depth lasts a
second (`ttus_opt.problem.terms.part_noise`).

Source: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning
(2006); the precision after F. Lindgren, H. Rue, J. Lindström, J. R. Stat. Soc. B 73
(2011).
"""

from ttus_opt.contact.scene import Scene
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.terms.depth_map import DepthMapTerm
from ttus_opt.problem.terms.depth_map_estimate import estimate_depth_map
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm


def build(
    scene: Scene,
    force_weight: float | None = None,
    torque_weight: float | None = None,
    torque_length: float | None = None,
    deviation: float | None = None,
    surface_length: float | None = None,
    depth_length: float | None = None,
    length_ratio: float | None = None,
) -> Formulation:
    """Weights λ_f, λ_τ [1/N²], ℓ [m], σ [–], Matérn lengths [m], ratio [–]."""
    found = estimate_depth_map(
        scene,
        deviation=deviation,
        surface_length=surface_length,
        depth_length=depth_length,
        length_ratio=length_ratio,
    )
    noise = found.part_noise(scene)
    likely = noise.level**-2
    force = likely if force_weight is None else force_weight
    torque = likely if torque_weight is None else torque_weight
    return Formulation(
        terms=[
            DepthMapTerm.of(scene, found),
            ForceTerm(scene, force, noise=noise),
            TorqueTerm(scene, torque, torque_length, noise=noise),
        ]
    )
