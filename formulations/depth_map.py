"""A depth profile times a random variation over the patient, no Laplace prior.

min_p ‖R (p/φ − 1)‖²/σ² + λ_f ‖N p − f‖² + λ_τ ‖(W p − τ)/ℓ‖²

φ(d) = Σ_j c_j (d/10 mm)^a_j, c ≥ 0, is the same profile of the depth d below the
surface everywhere; RᵀR/σ² is the precision of a Gaussian field with a Matérn covariance
along the surface and along the depth. Coefficients, σ, the length along the surface and
the noise 1/√λ_f are chosen by their evidence unless they are given. Torque rows have no
weight by default.

Source: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning
(2006); the precision after F. Lindgren, H. Rue, J. Lindström, J. R. Stat. Soc. B 73
(2011).
"""

from ttus_opt.problem.formulation import Formulation
from ttus_opt.scene import Scene
from ttus_opt.terms.depth_map import DepthMapTerm
from ttus_opt.terms.depth_map_estimate import estimate_depth_map
from ttus_opt.terms.depth_map_limits import check_depth_map
from ttus_opt.terms.force import ForceTerm
from ttus_opt.terms.torque import TorqueTerm


def build(
    scene: Scene,
    force_weight: float | None = None,
    torque_weight: float = 0.0,
    torque_length: float | None = None,
    deviation: float | None = None,
    surface_length: float | None = None,
    depth_length: float = 0.015,
    length_ratio: float | None = None,
) -> Formulation:
    """Weights λ_f [1/N²], λ_τ [1/N²], ℓ [m], σ [–], Matérn lengths [m], ratio [–]."""
    torque = TorqueTerm(scene, torque_weight, torque_length)
    check_depth_map(
        scene.voxmap.grid,
        deviation=deviation,
        surface_length=surface_length,
        depth_length=depth_length,
        length_ratio=length_ratio,
    )
    found = estimate_depth_map(scene, depth_length=depth_length)
    weight = found.noise**-2 if force_weight is None else force_weight
    prior = DepthMapTerm.of(scene, found, deviation, surface_length, length_ratio)
    return Formulation(terms=[prior, ForceTerm(scene, weight), torque])
