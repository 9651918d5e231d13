"""Coulomb's limit of a drag field, |q| ≤ μ_max |p| with one sign, and of its mean.

The drag field lies between 0 and μ_max p, and m p with the mean coefficient m must do
so too: 0 ≤ m ≤ μ_max.

See docs/method/contact.md, Friction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttus_opt.core.errors import InputError
from ttus_opt.problem.constraints.base import Bounds, Constraint, LinearRows
from ttus_opt.problem.terms.rows import unit_rows

#: Least and largest μ_max: gel has some 0.05, rubber on skin 2 [–]
COEFFICIENTS = (1e-3, 100.0)


def check_coefficient(largest: float) -> None:
    """Validate a largest friction coefficient.

    Raises:
        InputError: Friction has no such coefficient.
    """
    low, high = COEFFICIENTS
    if not low <= largest <= high:
        raise InputError(
            f"largest friction must lie between {low:g} and {high:g}, got {largest}"
        )


@dataclass(frozen=True)
class DragLimit(Constraint):
    """The drag field is at most μ_max times the field, on either side of the surface.

    Attributes:
        largest: μ_max [–].
    """

    largest: float = 1.0

    name = "drag_limit"
    formula = "q ≤ μ_max p inside, q ≥ μ_max p outside"

    def __post_init__(self) -> None:
        """Validate the coefficient μ_max."""
        check_coefficient(self.largest)

    def rows(self) -> LinearRows:
        """μ_max p − q, at least 0 inside and at most 0 outside."""
        region = self.scene.voxmap.grid.flatten(self.scene.voxmap.region)
        at = np.flatnonzero(region != 0)
        rows = unit_rows(at, self.scene.n_voxels)
        blocks = {"p": self.largest * rows, "q": -rows}
        inside = region[at] > 0
        lower = np.where(inside, 0.0, -np.inf)
        return LinearRows(blocks, lower, np.where(inside, np.inf, 0.0))


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
