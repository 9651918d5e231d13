"""The Laplace prior ‖L p - s b‖² (paper eq. 8, first term of eq. 10; there s = 1)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

from ttus_opt.contact.scene import BOUNDARY_SCALE
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.problem.terms.base import AffineRows, Term
from ttus_opt.problem.terms.structure import LaplaceRows


@dataclass(frozen=True)
class LaplaceTerm(Term):
    """Squares of the scaled Laplace rows, Dirichlet rows included (soft).

    Attributes:
        factor: s, on the scene's boundary values [–].
    """

    factor: float = 1.0

    name = "laplace"

    @property
    def formula(self) -> str:
        """The formula, with the factor on b unless it is 1."""
        factor = "" if self.factor == 1.0 else f"{self.factor:.4g} "
        return f"‖L p − {factor}b‖²"

    def __post_init__(self) -> None:
        """Validate weight and factor."""
        super().__post_init__()
        if not (math.isfinite(self.factor) and self.factor > 0.0):
            raise InputError(f"factor on b must be positive, got {self.factor}")

    def with_factor(self, factor: float) -> Self:
        """The same prior with its boundary values times a factor."""
        return replace(self, factor=factor)

    def rows(self) -> AffineRows:
        """L and s b of the scene."""
        tags = frozenset({LaplaceRows("p")})
        return AffineRows({"p": self.scene.L}, self.factor * self.scene.b, tags)

    def parameters(self, values: Mapping[str, Array]) -> dict[str, float]:
        """The boundary scale, if the scene has fitted one."""
        if BOUNDARY_SCALE not in self.scene.parameters:
            return {}
        return {BOUNDARY_SCALE: self.factor * self.scene.parameters[BOUNDARY_SCALE]}
