"""A graph Laplacian over patches of skin: neighbours just below it are alike.

min_p ‖L p - b‖² + λ_f ‖N p - f‖² + λ_τ ‖(W p - τ)/ℓ‖² + α Σ (p_i - p_j)²
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ttus_opt.problem.formulation import load
from ttus_opt.problem.terms.base import AffineRows, Term


@dataclass(frozen=True)
class SkinGraph(Term):
    """Differences of neighbouring spokes and slices in the layer below the skin."""

    name = "skin_graph"

    def rows(self):
        """An edge a row."""
        voxmap, grid = self.scene.voxmap, self.scene.voxmap.grid
        below = np.argmax(voxmap.on_surface, axis=0) - 1
        index = grid.unflatten(np.arange(grid.n_voxels))
        voxels = np.take_along_axis(index, below[None], axis=0)[0]
        one = np.r_[voxels.ravel(), voxels[:, :-1].ravel()]
        other = np.r_[np.roll(voxels, -1, axis=0).ravel(), voxels[:, 1:].ravel()]
        edge, ones = np.arange(len(one)), np.ones(len(one))
        entries = np.r_[ones, -ones], (np.r_[edge, edge], np.r_[one, other])
        rows = sp.csr_array(entries, shape=(len(one), grid.n_voxels))
        return AffineRows({"p": rows}, np.zeros(len(one)))


def build(scene, force_weight=1e-2, torque_weight=1e-2, strength=1.0):
    """Weights λ_f, λ_τ and α [–]."""
    weights = {"force_weight": force_weight, "torque_weight": torque_weight}
    return load("eq10", scene, **weights) + SkinGraph(scene, strength)
