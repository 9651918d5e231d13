"""Sparse sources between the boundaries: absolute values of L p - b, not squares.

min_p α Σ|L p - b|_free + λ_f ‖N p - f‖² + λ_τ ‖(W p - τ)/ℓ‖²
s.t.  (p - b)_boundary = 0

By default α = 3 λ_f, or 3 λ_τ where λ_f = 0. Source: eq. 10 of Yeung, Black, Salcudean
(2025) with the penalty of R. Tibshirani, Regression Shrinkage and Selection via the
Lasso (1996).
"""

from ttus_opt.contact.scene import Scene
from ttus_opt.core.errors import InputError
from ttus_opt.problem.constraints.boundary import HardBoundary
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.terms.laplace import SparseSourcesTerm
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm


def build(
    scene: Scene,
    force_weight: float = 1e-2,
    torque_weight: float = 1e-2,
    torque_length: float | None = None,
    sparsity: float | None = None,
) -> Formulation:
    """Weights λ_f, λ_τ, α [–] and torque length ℓ [m]."""
    weight = 3.0 * (force_weight or torque_weight) if sparsity is None else sparsity
    if weight == 0.0 < max(force_weight, torque_weight):
        raise InputError(
            "sparsity must not be 0: nothing else holds an unmeasured field"
        )
    return Formulation(
        terms=[
            SparseSourcesTerm(scene, weight),
            ForceTerm(scene, force_weight),
            TorqueTerm(scene, torque_weight, torque_length),
        ],
        constraints=[HardBoundary(scene)],
    )
