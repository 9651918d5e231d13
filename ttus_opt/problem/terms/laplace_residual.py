"""The Laplace prior on the departure from a depth profile, ‖L (p - φ)‖².

φ is one function of the depth d below the surface, zero on the surface layer. The
boundary rows of L hold the field at φ: at zero on the skin, at the profile's value on
the inner layer, and at −φ(|d|) outside. The scene's boundary values are not used.

See docs/method/formulations.md, Depth map.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.problem.terms.base import AffineRows, Term
from ttus_opt.problem.terms.depth_profile import DepthProfile, voxel_depths
from ttus_opt.problem.terms.structure import LaplaceRows, Tag, Tags


@dataclass(frozen=True)
class LaplaceResidualTerm(Term):
    """Squares of the Laplace rows of p − φ, Dirichlet rows included (soft).

    Attributes:
        profile: φ.
    """

    profile: DepthProfile = field(default=DepthProfile((1.0,), (1.0,)))

    name = "laplace_residual"

    @property
    def formula(self) -> str:
        """The formula with φ."""
        return f"‖L (p − φ)‖², φ = {self.profile}"

    @cached_property
    def mean(self) -> Array:
        """φ at every voxel, zero on the surface layer, shape (V,) [unit of p]."""
        voxmap = self.scene.voxmap
        at_voxels = self.profile(voxel_depths(voxmap))
        return np.where(voxmap.on_surface.ravel(), 0.0, at_voxels)

    def rows(self) -> AffineRows:
        """L and L φ."""
        L = self.scene.L
        tags: Tags = frozenset({LaplaceRows("p"), Tag.OWN_MEAN})
        return AffineRows({"p": L}, L @ self.mean, tags)
