"""Tikhonov's term, heavier with depth below the skin.

min_p ‖L p - b‖² + λ_f ‖N p - f‖² + λ_τ ‖(W p - τ)/ℓ‖² + α ‖(d/5 cm) (p - p₀)‖²
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ttus_opt.problem.formulation import load
from ttus_opt.problem.terms.base import AffineRows, Term


@dataclass(frozen=True)
class DepthWeighted(Term):
    """Departures from the Laplace field, times the depth d below the skin."""

    name = "depth_weighted"

    def rows(self):
        """A diagonal, and what it makes of the Laplace field."""
        grid, scene = self.scene.voxmap.grid, self.scene
        theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
        skin = scene.voxmap.surface.radius_at(theta, z)
        depth = np.clip(skin - grid.r[:, None, None], 0.0, None) / 0.05
        rows = sp.csr_array(sp.diags_array(grid.flatten(depth)))
        return AffineRows({"p": rows}, rows @ scene.laplace.solve(scene.b))


def build(scene, force_weight=1e-2, torque_weight=1e-2, strength=1.0):
    """Weights λ_f, λ_τ and α [–]."""
    weights = {"force_weight": force_weight, "torque_weight": torque_weight}
    return load("eq10", scene, **weights) + DepthWeighted(scene, strength)
