"""Measured torques with drag, λ_τ ‖(W p − torque of drag − τ)/ℓ‖².

See docs/method.md, Friction.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import Self

from ttus_opt.terms.base import AffineRows
from ttus_opt.terms.drag import DragModel
from ttus_opt.terms.torque import TorqueTerm


@dataclass(frozen=True)
class DragTorqueTerm(TorqueTerm):
    """Squares of the torque residuals over ℓ with drag, of every frame [N²].

    Attributes:
        drag: How the skin drags.
    """

    drag: DragModel = field(kw_only=True, repr=False)

    name = "torque"

    @property
    def formula(self) -> str:  # type: ignore[override]
        """With what drag takes away."""
        drag = self.drag.formula.replace("F", "G")
        return f"‖(W p − {drag} − τ)/ℓ‖²"

    def rows(self) -> AffineRows:
        """W/ℓ and drag's rows by variable, and τ/ℓ."""
        return self._measured(self.drag.torque_blocks())

    def with_neutral(self, names: Collection[str]) -> Self:
        """The same term without this drag."""
        drag = self.drag.with_neutral(names)
        return self if drag is self.drag else replace(self, drag=drag)
