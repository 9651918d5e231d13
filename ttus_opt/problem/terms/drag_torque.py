"""Measured torques with drag, λ_τ ‖(W p − torque of drag − τ)/ℓ‖².

See docs/method/contact.md, Friction.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import Self

from ttus_opt.problem.terms.base import AffineRows
from ttus_opt.problem.terms.drag import DragModel
from ttus_opt.problem.terms.torque import TorqueTerm


@dataclass(frozen=True)
class DragTorqueTerm(TorqueTerm):
    """Squares of the torque residuals over ℓ with drag, of every frame [N²].

    Attributes:
        drag: The drag model.
    """

    drag: DragModel = field(kw_only=True, repr=False)

    name = "torque"

    @property
    def formula(self) -> str:  # type: ignore[override]
        """The formula with the torque of drag subtracted."""
        drag = self.drag.formula.replace("F", "G")
        return f"‖(W p − {drag} − τ)/ℓ‖²"

    def rows(self) -> AffineRows:
        """W/ℓ and the rows of drag by variable, and τ/ℓ."""
        return self._measured(self.drag.torque_blocks())

    def with_neutral(self, names: Collection[str]) -> Self:
        """The same term with these drag coefficients at 0."""
        drag = self.drag.with_neutral(names)
        return self if drag is self.drag else replace(self, drag=drag)
