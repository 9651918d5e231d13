"""Laplace prior without p = 0 on the surface.

With p = 0 on the surface the force on a round tip grows like depth²; on real tissue it
grows like depth¹ to depth^1.5 and begins at first touch. Here the rows of the surface
layer have only a small weight, which determines the field where nothing was measured
(the Laplace field of eq. 8) and hardly matters elsewhere. Both end slices keep their
values.

See docs/method/formulations.md, The shelf.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.errors import InputError
from ttus_opt.problem.terms.base import AffineRows, Term
from ttus_opt.problem.terms.structure import LaplaceRows


@dataclass(frozen=True)
class LaplaceFreeSurfaceTerm(Term):
    """Squares of the Laplace rows, with a small weight on those of the surface layer.

    Attributes:
        skin: Factor on the weight of the layer's rows; with 0 the field is undetermined
            where nothing was measured [–].
    """

    skin: float = 1e-3

    name = "laplace_free_surface"
    formula = "‖L p − b‖² without the surface's rows"

    def __post_init__(self) -> None:
        """Validate weight and the layer's share."""
        super().__post_init__()
        if not (math.isfinite(self.skin) and 0.0 <= self.skin <= 1.0):
            raise InputError(f"skin must lie between 0 and 1, got {self.skin}")

    def rows(self) -> AffineRows:
        """L and b with the surface layer's rows scaled by √skin."""
        scene = self.scene
        scale = np.ones(scene.n_voxels)
        layer = free_surface_layer(scene.voxmap.on_surface)
        if scene.voxmap.grid.wall is not None:
            layer[:, scene.voxmap.grid.wall] = False
        layer = layer.reshape(-1)
        scale[layer] = math.sqrt(self.skin)
        rows = sp.csr_array(sp.diags_array(scale) @ scene.L)
        rows.eliminate_zeros()
        tags = frozenset({LaplaceRows("p", scale)} if self.skin > 0.0 else ())
        return AffineRows({"p": rows}, scale * scene.b, tags)


def free_surface_layer(on_surface: np.ndarray) -> np.ndarray:
    """The surface layer without both end slices, shape (n_r, n_theta, n_z)."""
    layer = on_surface.copy()
    layer[:, :, [0, -1]] = False
    layer[[0, -1]] = False
    return layer
