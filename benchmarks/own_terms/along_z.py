"""Differences between neighbouring slices.

min_p ‖L p - b‖² + λ_f ‖N p - f‖² + λ_τ ‖(W p - τ)/ℓ‖² + α ‖D_z p‖²
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ttus_opt.problem.formulation import load
from ttus_opt.problem.terms.base import AffineRows, Term


@dataclass(frozen=True)
class AlongZ(Term):
    """Differences of neighbours along the body."""

    name = "along_z"

    def rows(self):
        """Two entries a row."""
        index = self.scene.voxmap.grid.unflatten(np.arange(self.scene.n_voxels))
        here, next_ = index[:, :, :-1].ravel(), index[:, :, 1:].ravel()
        row, one = np.arange(len(here)), np.ones(len(here))
        entries = np.r_[-one, one], (np.r_[row, row], np.r_[here, next_])
        rows = sp.csr_array(entries, shape=(len(here), self.scene.n_voxels))
        return AffineRows({"p": rows}, np.zeros(len(here)))


def build(scene, force_weight=1e-2, torque_weight=1e-2, strength=1.0):
    """Weights λ_f, λ_τ and α [–]."""
    weights = {"force_weight": force_weight, "torque_weight": torque_weight}
    return load("eq10", scene, **weights) + AlongZ(scene, strength)
