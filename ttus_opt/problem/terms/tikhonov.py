"""Tikhonov's term ‖p − p_ref‖², over the free voxels.

See docs/method/formulations.md, The shelf.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttus_opt.core.errors import InputError
from ttus_opt.problem.terms.base import AffineRows, Term
from ttus_opt.problem.terms.rows import unit_rows

REFERENCES = ("laplace", "zero")


@dataclass(frozen=True)
class TikhonovTerm(Term):
    """Squares of the departure from a reference field [unit of p, squared].

    Attributes:
        reference: "laplace" for the Laplace field p₀ = L⁻¹b, or "zero".
    """

    reference: str = "laplace"

    name = "tikhonov"
    formula = "‖p − p_ref‖² over free voxels"

    def __post_init__(self) -> None:
        """Validate weight and reference."""
        super().__post_init__()
        if self.reference not in REFERENCES:
            raise InputError(
                f"tikhonov reference must be one of {', '.join(REFERENCES)}, got "
                f"{self.reference!r}"
            )

    def rows(self) -> AffineRows:
        """Identity rows of the free voxels."""
        scene = self.scene
        free = np.flatnonzero(scene.laplace.free)
        rows = unit_rows(free, scene.n_voxels)
        target = np.zeros(len(free))
        if self.reference == "laplace":
            target = scene.laplace.solve(scene.b)[free]
        return AffineRows({"p": rows}, target)
