"""Eq. 10 with Coulomb drag of a voxel field q, the friction coefficient times p.

min_{p,q,m} ‖L p - b‖² + α ‖L q - m b‖²
            + λ_f ‖N p - F q - f‖² + λ_τ ‖(W p - G q - τ)/ℓ‖²
s.t.  0 ≤ q ≤ μ_max p inside, q = 0 on the surface, μ_max p ≤ q ≤ 0 outside,
      0 ≤ m ≤ μ_max

F q is drag of every point of the probe, or t̂ (n̂ᵀ N q) of the whole patch, t̂ its
direction of sliding and n̂ its normal (``acts_at``, see `coulomb_global`); jointly
convex in (p, q, m). m is the mean friction coefficient: q = m p where it applies.
Source: eq. 10 of Yeung, Black, Salcudean (2025) with Coulomb's law.
"""

from ttus_opt.contact.friction import DEADBAND
from ttus_opt.contact.scene import Scene
from ttus_opt.problem.constraints.signs import (
    DragLimit,
    DragSign,
    MeanFriction,
    check_coefficient,
)
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.terms.drag import CoulombField
from ttus_opt.problem.terms.drag_estimate import estimate_drag
from ttus_opt.problem.terms.laplace import DragSmoothnessTerm, LaplaceTerm
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm


def build(
    scene: Scene,
    force_weight: float = 1e-2,
    torque_weight: float = 1e-2,
    torque_length: float | None = None,
    smoothness: float = 1.0,
    largest_friction: float = 1.0,
    acts_at: str = "auto",
    deadband: float = DEADBAND,
) -> Formulation:
    """Weights λ_f, λ_τ, α, μ_max [–], ℓ [m], where drag acts, deadband v₀ [m/s]."""
    check_coefficient(largest_friction)
    where = estimate_drag(scene, acts_at, deadband).acts_at
    drag = CoulombField(scene, where, deadband, largest_friction)
    return Formulation(
        terms=[
            LaplaceTerm(scene),
            DragSmoothnessTerm(scene, smoothness),
            ForceTerm(scene, force_weight, drag=drag),
            TorqueTerm(scene, torque_weight, torque_length, drag=drag),
        ],
        constraints=[
            DragSign(scene),
            DragLimit(scene, largest_friction),
            MeanFriction(scene, largest_friction),
        ],
    )
