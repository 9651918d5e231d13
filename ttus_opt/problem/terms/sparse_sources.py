"""Sparse sources, Σ |L p − b| over the free voxels.

L p − b are the sources and sinks of the field between the boundaries. Squares spread
them over all voxels; absolute values concentrate them in few, such as a rib's edge.

See docs/method/formulations.md, Penalties.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttus_opt.problem.terms.base import AffineRows, Term
from ttus_opt.problem.terms.penalties.absolute import Absolute
from ttus_opt.problem.terms.structure import LaplaceRows


@dataclass(frozen=True)
class SparseSourcesTerm(Term):
    """Absolute values of the scaled Laplace rows of free voxels, no Dirichlet rows."""

    name = "sparse_sources"
    formula = "Σ |L p − b| over free voxels"

    @property
    def penalty(self) -> Absolute:
        """Absolute values."""
        return Absolute()

    def rows(self) -> AffineRows:
        """Free rows of L and b."""
        free = np.flatnonzero(self.scene.laplace.free)
        tag = LaplaceRows(scale=np.ones(self.scene.n_voxels))
        rows = {"p": self.scene.L[free]}
        return AffineRows(rows, self.scene.b[free], frozenset({tag}))
