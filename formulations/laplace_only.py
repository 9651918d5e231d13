"""The Laplace prior alone: the field before any measurement (paper eq. 8).

min_p ‖L p - b‖²
"""

from ttus_opt.contact.scene import Scene
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.terms.laplace import LaplaceTerm


def build(scene: Scene) -> Formulation:
    """Eq. 8 as least squares; its minimum is zero."""
    return Formulation(terms=[LaplaceTerm(scene)])
