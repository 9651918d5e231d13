"""Eq. 10 with Coulomb drag of one friction coefficient μ, found by a search.

min_μ min_p ‖L p - b‖² + λ_f ‖(N - μ F) p - f‖² + λ_τ ‖((W - μ G) p - τ)/ℓ‖²

F p = t̂ (n̂ᵀ N p) with t̂ the direction of sliding, n̂ the contact's normal: convex in p
for every μ. Source: eq. 10 of Yeung, Black, Salcudean (2025) with Coulomb's law.
"""

from ttus_opt.drag_estimate import estimate_drag
from ttus_opt.friction import DEADBAND
from ttus_opt.problem.formulation import Formulation, Search
from ttus_opt.scene import Scene
from ttus_opt.terms.drag import GlobalCoulomb
from ttus_opt.terms.drag_force import DragForceTerm
from ttus_opt.terms.drag_torque import DragTorqueTerm
from ttus_opt.terms.laplace import LaplaceTerm


def build(
    scene: Scene,
    force_weight: float = 1e-4,
    torque_weight: float = 1e-4,
    torque_length: float | None = None,
    largest_friction: float = 1.0,
    acts_at: str = "auto",
    deadband: float = DEADBAND,
) -> Formulation:
    """Weights λ_f, λ_τ [–], ℓ [m], range of μ, where drag acts, deadband v₀ [m/s]."""
    guess = estimate_drag(scene, acts_at, deadband)
    drag = GlobalCoulomb(scene, guess.acts_at, deadband)
    prior = LaplaceTerm(scene)

    def given(friction: float) -> Formulation:
        dragged = drag.with_coefficient(friction)
        return Formulation(
            terms=[
                prior,
                DragForceTerm(scene, force_weight, drag=dragged),
                DragTorqueTerm(scene, torque_weight, torque_length, drag=dragged),
            ]
        )

    first = given(min(guess.friction_coefficient, largest_friction))
    return first.with_search(
        Search("friction_coefficient", 0.0, largest_friction, given)
    )
