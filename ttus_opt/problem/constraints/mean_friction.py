"""Limits of the mean friction coefficient m, 0 ≤ m ≤ μ_max.

The drag field lies between 0 and μ_max p, and m p must do so too.

See docs/method/contact.md, Friction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttus_opt.problem.constraints.base import Bounds, Constraint
from ttus_opt.problem.constraints.drag_limit import check_coefficient


@dataclass(frozen=True)
class MeanFriction(Constraint):
    """The mean friction coefficient lies in the range of the drag field's.

    Attributes:
        largest: μ_max [–].
    """

    largest: float = 1.0

    name = "mean_friction"
    formula = "0 ≤ m ≤ μ_max"

    def __post_init__(self) -> None:
        """Refuse a μ_max that is not positive."""
        check_coefficient(self.largest)

    def rows(self) -> Bounds:
        """Bounds on m."""
        return Bounds("m", np.zeros(1), np.full(1, self.largest))
