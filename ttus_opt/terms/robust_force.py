"""Measured forces, robust against outliers: Huber's penalty of N p − f (design §3).

Up to δ a residual is charged by its square as in eq. 10, beyond it in proportion to
its size, so that slipped frames, hairs and cable pulls do not bend the field.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ttus_opt.errors import InputError
from ttus_opt.terms.base import AffineRows, Penalty, Term


@dataclass(frozen=True)
class RobustForceTerm(Term):
    """Huber's penalty of every component of every force residual [N²].

    Attributes:
        limit: δ, where squares end; about twice the sensor's noise and the model's
            own error together [N].
    """

    limit: float = 0.5

    name = "robust_force"
    formula = "Σ huber(N p − f; δ)"
    measures = True

    def __post_init__(self) -> None:
        """Refuse a limit that is none.

        Raises:
            InputError: The weight or the limit is not usable.
        """
        super().__post_init__()
        if not (math.isfinite(self.limit) and self.limit > 0.0):
            raise InputError(
                f"robust_force limit must be positive [N], got {self.limit}"
            )
        object.__setattr__(self, "formula", f"Σ huber(N p − f; {self.limit:g} N)")

    @property
    def penalty(self) -> Penalty:
        """Huber's."""
        return Penalty.HUBER

    @property
    def threshold(self) -> float:
        """δ [N]."""
        return self.limit

    def rows(self) -> AffineRows:
        """N and f of the scene."""
        return AffineRows({"p": self.scene.N}, self.scene.f)
