"""Measured forces, robust against outliers: Huber's penalty of N p − f.

Up to δ the penalty is the square, as in eq. 10, beyond it proportional to the residual,
so that slipping, hair and cable pulls do not distort the field.

See docs/method/formulations.md, Penalties.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ttus_opt.core.errors import InputError
from ttus_opt.problem.terms.base import AffineRows, Term
from ttus_opt.problem.terms.penalties.huber import Huber


@dataclass(frozen=True)
class RobustForceTerm(Term):
    """Huber's penalty of every component of every force residual [N²].

    Attributes:
        limit: δ, the largest squared residual; about twice the sensor noise and model
            error together [N].
    """

    limit: float = 0.5

    name = "robust_force"
    measures = True

    @property
    def formula(self) -> str:
        """The formula with δ."""
        return f"Σ huber(N p − f; {self.limit:g} N)"

    def __post_init__(self) -> None:
        """Validate weight and limit."""
        super().__post_init__()
        if not (math.isfinite(self.limit) and self.limit > 0.0):
            raise InputError(
                f"robust_force limit must be positive [N], got {self.limit}"
            )

    @property
    def penalty(self) -> Huber:
        """Huber's, with δ [N]."""
        return Huber(self.limit)

    def rows(self) -> AffineRows:
        """N and f of the scene."""
        return AffineRows({"p": self.scene.N}, self.scene.f)
