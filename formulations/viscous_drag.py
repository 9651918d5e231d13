"""Eq. 10 with viscous drag of the skin, one coefficient or one per region.

min_{p,c} ‖L p - b‖² + λ_f ‖N p - v c - f‖² + λ_τ ‖(W p - a×v c - τ)/ℓ‖²  s.t.  c ≥ 0

v is the sliding velocity along the contact and a the arm of drag. Source: eq. 10 of
Yeung, Black, Salcudean (2025), with a column per drag coefficient.
"""

from ttus_opt.contact.scene import Scene
from ttus_opt.problem.constraints.signs import ViscousSign
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.terms.drag import Viscous
from ttus_opt.problem.terms.drag_estimate import estimate_drag
from ttus_opt.problem.terms.laplace import LaplaceTerm
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm


def build(
    scene: Scene,
    force_weight: float = 1e-2,
    torque_weight: float = 1e-2,
    torque_length: float | None = None,
    sectors: int = 1,
    bands: int = 1,
    acts_at: str = "auto",
) -> Formulation:
    """Weights λ [–], length ℓ [m], regions around and along, where drag acts."""
    where = estimate_drag(scene, acts_at, places=("contact", "reference")).acts_at
    drag = Viscous(scene, where, sectors=sectors, bands=bands)
    return Formulation(
        terms=[
            LaplaceTerm(scene),
            ForceTerm(scene, force_weight, drag=drag),
            TorqueTerm(scene, torque_weight, torque_length, drag=drag),
        ],
        constraints=[ViscousSign(scene, sectors * bands)],
    )
