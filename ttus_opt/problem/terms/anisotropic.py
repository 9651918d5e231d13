"""Anisotropic Laplace prior, ‖Δr² ∇·(K ∇p) − b‖².

Conductivities k_r, k_θ, k_z, constant along their coordinate: muscle and skin carry
load further along one direction than across it.

See docs/method/contact.md, Variants.
"""

from __future__ import annotations

from dataclasses import dataclass

from ttus_opt.problem.terms.base import AffineRows, Term
from ttus_opt.problem.terms.structure import LaplaceRows


@dataclass(frozen=True)
class AnisotropicTerm(Term):
    """Squares of the anisotropic Laplace rows, Dirichlet rows included (soft).

    Attributes:
        conductivities: k_r, k_θ, k_z [–].
    """

    conductivities: tuple[float, float, float] = (1.0, 1.0, 1.0)

    name = "anisotropic"

    @property
    def formula(self) -> str:
        """The formula with the conductivities."""
        given = ", ".join(f"{k:g}" for k in self.conductivities)
        return f"‖L(k = {given}) p − b‖²"

    def rows(self) -> AffineRows:
        """The anisotropic operator and its b."""
        scene = self.scene
        system = scene.laplace.variant(conductivities=self.conductivities)
        target = system.right_side(scene.inner, scene.outer)
        tags = frozenset({LaplaceRows("p", system=system)})
        return AffineRows({"p": system.L}, target, tags)
