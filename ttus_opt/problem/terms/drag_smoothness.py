"""Prior of the drag field q, ‖L q − m b‖².

Measurements determine q only where the probe slid. Where friction is the same
everywhere q = μ p, which satisfies L q = μ b as p satisfies L p = b. Elsewhere q
therefore follows a mean friction coefficient m times p, and m is found with it.

See docs/method/contact.md, Friction.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.problem.terms.base import AffineRows, Fitted, Term
from ttus_opt.problem.terms.structure import LaplaceRows

#: Name of m among the parameters of a fitted field
MEAN_FRICTION = "mean_friction_coefficient"


@dataclass(frozen=True)
class DragSmoothnessTerm(Term):
    """Squares of the scaled Laplace rows of q, Dirichlet rows included (soft).

    Attributes:
        has_mean: Whether m is a variable; otherwise it is 0.
    """

    has_mean: bool = True

    name = "drag_smoothness"

    @property
    def formula(self) -> str:
        """The formula with or without m."""
        return "‖L q − m b‖²" if self.has_mean else "‖L q‖²"

    def rows(self) -> AffineRows:
        """L over q, and -b over the mean friction coefficient m."""
        b = self.scene.b
        if not self.has_mean:
            tags = frozenset({LaplaceRows("q")})
            return AffineRows({"q": self.scene.L}, np.zeros(len(b)), tags)
        mean = sp.csr_array(-b[:, None])
        tags = frozenset({LaplaceRows("q", beside=("m",))})
        return AffineRows({"q": self.scene.L, "m": mean}, np.zeros(len(b)), tags)

    def parameters(self, values: Mapping[str, Array]) -> dict[str, float]:
        """The mean friction coefficient."""
        return {MEAN_FRICTION: float(values["m"][0]) if self.has_mean else 0.0}

    def fitted(self, values: Mapping[str, Array]) -> dict[str, Fitted]:
        """The coefficient m, with span 1: drag then equals the normal force."""
        return {MEAN_FRICTION: Fitted({"m": np.ones(1)}, 1.0)} if self.has_mean else {}

    def with_neutral(self, names: Collection[str]) -> Self:
        """The same prior, with m = 0 if it is among the names."""
        return replace(self, has_mean=False) if MEAN_FRICTION in names else self
