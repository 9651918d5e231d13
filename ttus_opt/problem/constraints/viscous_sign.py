"""Sign of the viscous coefficients, c ≥ 0.

See docs/method/contact.md, Friction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttus_opt.problem.constraints.base import Bounds, Constraint


@dataclass(frozen=True)
class ViscousSign(Constraint):
    """Viscous drag never pushes the probe along.

    Attributes:
        n_regions: Number of coefficients [–].
    """

    n_regions: int = 1

    name = "viscous_sign"
    formula = "c ≥ 0"

    def rows(self) -> Bounds:
        """Bounds on c."""
        return Bounds("c", np.zeros(self.n_regions), np.full(self.n_regions, np.inf))
