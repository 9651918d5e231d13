"""The Laplace prior ‖L p - b‖² (paper eq. 8, first term of eq. 10)."""

from __future__ import annotations

from dataclasses import dataclass

from ttus_opt.terms.base import AffineRows, Term


@dataclass(frozen=True)
class LaplaceTerm(Term):
    """Squares of the scaled Laplace rows, Dirichlet rows included (soft)."""

    name = "laplace"
    formula = "‖L p − b‖²"

    def rows(self) -> AffineRows:
        """L and b of the scene."""
        return AffineRows({"p": self.scene.L}, self.scene.b)
