"""A depth map with Coulomb drag of one friction coefficient μ, found by a search.

min_μ min_p ‖R (p/φ − 1)‖²/σ² + λ_f ‖Σ_f⁻¹ᐟ² ((N − μ F) p − f)‖²
                              + λ_τ ‖Σ_τ⁻¹ᐟ² ((W − μ G) p − τ)/ℓ‖²

The profile φ, σ, the lengths and the noise are chosen once, by their evidence at a
first estimate of μ. F p is drag of every point of the probe, or of the whole patch
(``acts_at``), by default what evidence says; drag of the patch may hold a probe at rest
(`ttus_opt.haptic.presliding`) where the recordings determine it. See `depth_map` and
`coulomb_global`.

Source: as `depth_map`, with Coulomb's law.
"""

from functools import partial

from ttus_opt.contact.friction import DEADBAND
from ttus_opt.contact.scene import Scene
from ttus_opt.problem.constraints.signs import check_coefficient
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.friction_search import with_drag, with_friction_search
from ttus_opt.problem.terms.depth_map import DepthMapTerm
from ttus_opt.problem.terms.drag_estimate import estimate_dragged
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm


def build(
    scene: Scene,
    force_weight: float | None = None,
    torque_weight: float | None = None,
    torque_length: float | None = None,
    depth_length: float | None = None,
    largest_friction: float = 1.0,
    acts_at: str = "auto",
    deadband: float = DEADBAND,
) -> Formulation:
    """λ_f, λ_τ [1/N²], lengths [m], range of μ, where drag acts, deadband."""
    check_coefficient(largest_friction)
    where = acts_at, deadband, largest_friction
    guess, found = estimate_dragged(scene, *where, depth_length=depth_length)
    noise = found.part_noise(scene)
    usual = noise.level**-2
    weight = usual if force_weight is None else force_weight
    turning = usual if torque_weight is None else torque_weight
    force = ForceTerm(scene, weight, noise=noise)
    torque = TorqueTerm(scene, turning, torque_length, noise=noise)
    declared = Formulation(terms=[DepthMapTerm.of(scene, found), force, torque])
    given = partial(with_drag, declared)
    return with_friction_search(guess, given, largest_friction, likely=True)
