"""Measured forces, λ_f ‖N p - f‖² (paper eqs. 6, 10)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import scipy.sparse as sp

from ttus_opt.problem.terms.base import AffineRows, Term
from ttus_opt.problem.terms.part_noise import PartNoise, whitened


@dataclass(frozen=True)
class ForceTerm(Term):
    """Squares of the force residuals of every frame [N²].

    Attributes:
        noise: Relative errors of normal and tangential forces, by which residuals are
            divided; None for equal ones.
    """

    noise: PartNoise | None = field(default=None, kw_only=True)

    name = "force"
    formula = "‖N p − f‖²"
    measures = True

    def rows(self) -> AffineRows:
        """N and f of the scene."""
        return self._measured({"p": self.scene.N})

    def _measured(self, blocks: Mapping[str, sp.csr_array]) -> AffineRows:
        """Rows by variable and the measured forces, over their relative errors."""
        if self.noise is None:
            return AffineRows(blocks, self.scene.f)
        return whitened(self.noise.force, blocks, self.scene.f)
