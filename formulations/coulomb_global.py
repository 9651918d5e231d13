"""Eq. 10 with Coulomb drag of one friction coefficient μ, found by a search.

min_μ min_s min_p ‖L p - s b‖² + λ_f ‖(N - μ F) p - f‖² + λ_τ ‖((W - μ G) p - τ)/ℓ‖²

F p is drag per unit of μ: that of every point of the probe by its own normal force and
against its own sliding (``points``), or t̂ (n̂ᵀ N p) of the whole patch, t̂ its direction
of sliding and n̂ its normal; "auto" takes what fits better. Convex in p for every μ.
Drag of the patch may hold a probe at rest (`ttus_opt.haptic.presliding`): t̂ is then the
deflection of a bristle, where the recordings determine its length, also searched.

s rescales boundary values that the scene has fitted (``inner="fit"``), by the same
objective at the μ found; given ones keep s = 1. The scene's own fit treats the residual
of the Laplace field as independent noise, although the fit explains most of it: at
λ = 1e-2 its scale is 2 to 6 % too large.

Forces with drag are then fitted as well as eq. 10 fits the same contacts without drag.
Drag increases a force by up to √(1 + μ²), which eq. 10 neglects; where its field is too
stiff, this improves its magnitudes. Torque rows worsen force directions by about 1° at
λ = 1e-2; by a third of that where ℓ is the ratio of torque noise to force noise.

Source: eq. 10 of Yeung, Black, Salcudean (2025) with Coulomb's law.
"""

from functools import partial

from ttus_opt.contact.friction import DEADBAND
from ttus_opt.contact.scene import BOUNDARY_SCALE, Scene
from ttus_opt.problem.constraints.signs import check_coefficient
from ttus_opt.problem.formulation import Formulation, Search
from ttus_opt.problem.friction_search import with_drag, with_friction_search
from ttus_opt.problem.terms.drag import GlobalCoulomb
from ttus_opt.problem.terms.drag_estimate import estimate_drag
from ttus_opt.problem.terms.laplace import LaplaceTerm
from ttus_opt.problem.terms.part_noise import PartNoise
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm


def build(
    scene: Scene,
    force_weight: float = 1e-2,
    torque_weight: float = 1e-2,
    torque_length: float | None = None,
    largest_friction: float = 1.0,
    acts_at: str = "auto",
    deadband: float = DEADBAND,
    direction_error: float | None = None,
) -> Formulation:
    """λ_f, λ_τ [–], ℓ [m], range of μ, where drag acts, v₀ [m/s], as `eq10` [rad]."""
    check_coefficient(largest_friction)
    noise = PartNoise.of_direction(scene, direction_error)
    guess = estimate_drag(scene, acts_at, deadband)
    force = ForceTerm(scene, force_weight, noise=noise)
    torque = TorqueTerm(scene, torque_weight, torque_length, noise=noise)
    declared = Formulation(terms=[LaplaceTerm(scene), force, torque])
    fitted = scene.parameters.keys() - scene.not_identified.keys()
    fits_scale = BOUNDARY_SCALE in fitted and force_weight > 0.0
    given = partial(_searching_scale if fits_scale else with_drag, declared)
    return with_friction_search(guess, given, largest_friction)


def _searching_scale(declared: Formulation, drag: GlobalCoulomb) -> Formulation:
    dragged = with_drag(declared, drag)
    scaled = partial(_scaled, dragged)
    return dragged.with_search(Search(BOUNDARY_SCALE, 0.5, 2.0, scaled, neutral=1.0))


def _scaled(dragged: Formulation, s: float) -> Formulation:
    prior = LaplaceTerm(dragged.scene).with_factor(s)
    return Formulation(terms=[prior, *dragged.terms[1:]])
