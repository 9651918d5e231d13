"""Measured wrenches with drag, λ_f ‖N p − drag − f‖² and the like of torques.

See docs/method/contact.md, Friction.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Self

from ttus_opt.core.arrays import Array
from ttus_opt.problem.terms.base import AffineRows, Fitted, Term
from ttus_opt.problem.terms.drag import DragModel
from ttus_opt.problem.terms.force import ForceTerm
from ttus_opt.problem.terms.torque import TorqueTerm


@dataclass(frozen=True)
class _Dragged(Term):
    """A term with a drag model, whose coefficients may be at 0."""

    drag: DragModel = field(kw_only=True, repr=False)

    def with_neutral(self, names: Collection[str]) -> Self:
        """The same term with these drag coefficients at 0."""
        drag = self.drag.with_neutral(names)
        return self if drag is self.drag else replace(self, drag=drag)


@dataclass(frozen=True)
class DragForceTerm(_Dragged, ForceTerm):
    """Squares of the force residuals with drag, of every frame [N²].

    Attributes:
        drag: The drag model.
    """

    name = "force"

    @property
    def formula(self) -> str:  # type: ignore[override]
        """The formula with the drag subtracted."""
        return f"‖N p − {self.drag.formula} − f‖²"

    def rows(self) -> AffineRows:
        """N and the rows of drag by variable, and f."""
        return self._measured(self.drag.force_blocks())

    def parameters(self, values: Mapping[str, Array]) -> dict[str, float]:
        """The drag coefficients."""
        return self.drag.parameters(values)

    def fitted(self, values: Mapping[str, Array]) -> dict[str, Fitted]:
        """The drag coefficients that are variables."""
        return self.drag.fitted(values)

    def not_identifiable(self) -> dict[str, str]:
        """The drag coefficients that no pose determines."""
        return self.drag.not_identifiable()


@dataclass(frozen=True)
class DragTorqueTerm(_Dragged, TorqueTerm):
    """Squares of the torque residuals over ℓ with drag, of every frame [N²].

    Attributes:
        drag: The drag model.
    """

    name = "torque"

    @property
    def formula(self) -> str:  # type: ignore[override]
        """The formula with the torque of drag subtracted."""
        drag = self.drag.formula.replace("F", "G")
        return f"‖(W p − {drag} − τ)/ℓ‖²"

    def rows(self) -> AffineRows:
        """W/ℓ and the rows of drag by variable, and τ/ℓ."""
        return self._measured(self.drag.torque_blocks())
