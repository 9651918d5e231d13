"""Measured forces, λ_f ‖N p - f‖² (paper eqs. 6, 10)."""

from __future__ import annotations

from dataclasses import dataclass

from ttus_opt.terms.base import AffineRows, Term


@dataclass(frozen=True)
class ForceTerm(Term):
    """Squares of the force residuals of every frame [N²]."""

    name = "force"
    formula = "‖N p − f‖²"
    measures = True

    def rows(self) -> AffineRows:
        """N and f of the scene."""
        return AffineRows({"p": self.scene.N}, self.scene.f)
