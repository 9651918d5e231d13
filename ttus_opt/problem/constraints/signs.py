"""Signs of the variables: of the field, of a drag field, of viscous coefficients.

See docs/method/formulations.md, The shelf, and docs/method/contact.md, Friction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttus_opt.problem.constraints.base import Bounds, Constraint


@dataclass(frozen=True)
class Sign(Constraint):
    """The field pushes out of the patient, never in."""

    name = "sign"
    formula = "p ≥ 0 inside, p ≤ 0 outside"

    def rows(self) -> Bounds:
        """Bounds on p; the surface layer is left to its Dirichlet rows."""
        region = self.scene.voxmap.grid.flatten(self.scene.voxmap.region)
        lower = np.where(region > 0, 0.0, -np.inf)
        upper = np.where(region < 0, 0.0, np.inf)
        return Bounds("p", lower, upper)


@dataclass(frozen=True)
class NonNegative(Constraint):
    """Touch never pulls: the field is not negative from the surface inwards."""

    name = "nonnegative"
    formula = "p ≥ 0 inside and on the surface"

    def rows(self) -> Bounds:
        """Bounds on p."""
        region = self.scene.voxmap.grid.flatten(self.scene.voxmap.region)
        lower = np.where(region >= 0, 0.0, -np.inf)
        return Bounds("p", lower, np.full(len(region), np.inf))


@dataclass(frozen=True)
class DragSign(Constraint):
    """Drag opposes the motion: the drag field has the sign of the field.

    It is zero on the surface layer, so that samples across it interpolate through zero.
    """

    name = "drag_sign"
    formula = "q ≥ 0 inside, q = 0 on the surface, q ≤ 0 outside"

    def rows(self) -> Bounds:
        """Bounds on q."""
        region = self.scene.voxmap.grid.flatten(self.scene.voxmap.region)
        lower = np.where(region >= 0, 0.0, -np.inf)
        upper = np.where(region <= 0, 0.0, np.inf)
        return Bounds("q", lower, upper)


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
