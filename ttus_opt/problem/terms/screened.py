"""Screened Laplace (Helmholtz) prior, ‖Δr²(∇²p − κ²p) − b‖².

The boundary's influence decays over the length 1/κ: the field flattens with depth, as
if tissue farther than 1/κ away did not push back.

See docs/method/contact.md, Variants.
"""

from __future__ import annotations

from dataclasses import dataclass

from ttus_opt.problem.terms.base import AffineRows, Term
from ttus_opt.problem.terms.structure import LaplaceRows


@dataclass(frozen=True)
class ScreenedTerm(Term):
    """Squares of the screened Laplace rows, Dirichlet rows included (soft).

    Attributes:
        screening: κ [1/m].
    """

    screening: float = 10.0

    name = "screened"

    @property
    def formula(self) -> str:
        """The formula with κ."""
        return f"‖(L − Δr²κ²) p − b‖², κ = {self.screening:g}/m"

    def rows(self) -> AffineRows:
        """The screened operator and its b, whose end slices are screened too."""
        scene = self.scene
        system = scene.laplace.variant(screening=self.screening)
        target = system.right_side(scene.inner, scene.outer)
        tags = frozenset({LaplaceRows("p", system=system)})
        return AffineRows({"p": system.L}, target, tags)
