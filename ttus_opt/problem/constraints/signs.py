"""Signs of the variables, and Coulomb's limit |q| ≤ μ_max |p| of a drag field.

The drag field lies between 0 and μ_max p, and m p with the mean coefficient m must do
so too: 0 ≤ m ≤ μ_max.

See docs/method/formulations.md, The shelf, and docs/method/friction.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ttus_opt.contact.scene import Scene
from ttus_opt.core.arguments import expect_between
from ttus_opt.core.arrays import Mask
from ttus_opt.problem.constraints.base import Bounds, Constraint, LinearRows
from ttus_opt.problem.terms.rows import unit_rows


def _regions(scene: Scene) -> NDArray[np.int8]:
    """The region of every voxel, above 0 inside, shape (V,)."""
    return np.asarray(scene.voxmap.grid.flatten(scene.voxmap.region))


def _zero_bounds(variable: str, from_below: Mask, from_above: Mask) -> Bounds:
    """Bounds at zero where a value may not be below, and above."""
    lower = np.where(from_below, 0.0, -np.inf)
    return Bounds(variable, lower, np.where(from_above, 0.0, np.inf))


@dataclass(frozen=True)
class Sign(Constraint):
    """The field pushes out of the patient, never in."""

    name = "sign"
    formula = "p ≥ 0 inside, p ≤ 0 outside"

    def rows(self) -> Bounds:
        """Bounds on p; the surface layer is left to its Dirichlet rows."""
        region = _regions(self.scene)
        return _zero_bounds("p", region > 0, region < 0)


@dataclass(frozen=True)
class NonNegative(Constraint):
    """Touch never pulls: the field is not negative from the surface inwards."""

    name = "nonnegative"
    formula = "p ≥ 0 inside and on the surface"

    def rows(self) -> Bounds:
        """Bounds on p."""
        region = _regions(self.scene)
        return _zero_bounds("p", region >= 0, np.zeros(len(region), bool))


@dataclass(frozen=True)
class DragSign(Constraint):
    """Drag opposes the motion: the drag field has the sign of the field.

    It is zero on the surface layer, so that samples across it interpolate through zero.
    """

    name = "drag_sign"
    formula = "q ≥ 0 inside, q = 0 on the surface, q ≤ 0 outside"

    def rows(self) -> Bounds:
        """Bounds on q."""
        region = _regions(self.scene)
        return _zero_bounds("q", region >= 0, region <= 0)


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


#: Least and largest μ_max: gel has some 0.05, rubber on skin 2 [–]
COEFFICIENTS = (1e-3, 100.0)


def check_coefficient(largest: float) -> None:
    """Validate a largest friction coefficient.

    Raises:
        InputError: Friction has no such coefficient.
    """
    expect_between(largest, *COEFFICIENTS, "largest friction")


@dataclass(frozen=True)
class _Limited(Constraint):
    """A constraint by the largest friction coefficient.

    Attributes:
        largest: μ_max [–].
    """

    largest: float = 1.0

    def __post_init__(self) -> None:
        """Validate the coefficient μ_max."""
        check_coefficient(self.largest)


@dataclass(frozen=True)
class DragLimit(_Limited):
    """The drag field is at most μ_max times the field, on either side of the skin."""

    name = "drag_limit"
    formula = "q ≤ μ_max p inside, q ≥ μ_max p outside"

    def rows(self) -> LinearRows:
        """μ_max p − q, at least 0 inside and at most 0 outside."""
        region = _regions(self.scene)
        at = np.flatnonzero(region != 0)
        rows = unit_rows(at, self.scene.n_voxels)
        blocks = {"p": self.largest * rows, "q": -rows}
        inside = region[at] > 0
        lower = np.where(inside, 0.0, -np.inf)
        return LinearRows(blocks, lower, np.where(inside, np.inf, 0.0))


@dataclass(frozen=True)
class MeanFriction(_Limited):
    """The mean friction coefficient lies in the range of the drag field's."""

    name = "mean_friction"
    formula = "0 ≤ m ≤ μ_max"

    def rows(self) -> Bounds:
        """Bounds on m."""
        return Bounds("m", np.zeros(1), np.full(1, self.largest))
