"""Dirichlet values as equalities, p = b on the boundary voxels.

See docs/method/contact.md, Boundary values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttus_opt.problem.constraints.base import Constraint, LinearRows
from ttus_opt.problem.terms.rows import unit_rows
from ttus_opt.problem.terms.structure import Tag


@dataclass(frozen=True)
class HardBoundary(Constraint):
    """Boundary voxels have their given values exactly, not in least squares."""

    name = "boundary"
    formula = "p = b on inner, outer and surface layer and both ends"

    def rows(self) -> LinearRows:
        """Identity rows of the Dirichlet voxels."""
        fixed = np.flatnonzero(~self.scene.laplace.free)
        rows, values = unit_rows(fixed, self.scene.n_voxels), self.scene.b[fixed]
        return LinearRows({"p": rows}, values, values, frozenset({Tag.DIRICHLET}))
