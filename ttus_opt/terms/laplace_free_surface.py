"""Laplace prior without p = 0 on the skin.

With p = 0 on the skin the force of a round tip grows like depth²; real tissue grows
like depth¹ to depth^1.5 and pushes back from the first touch. Here the rows of the
skin's voxels are kept with a small weight only, which decides where nothing was
measured (there the field is the Laplace field of eq. 8) and gives way elsewhere.
The skin at both ends keeps its values.

See docs/method.md, The shelf.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ttus_opt.errors import InputError
from ttus_opt.terms.base import AffineRows, Term
from ttus_opt.terms.structure import LaplaceRows


@dataclass(frozen=True)
class LaplaceFreeSurfaceTerm(Term):
    """Squares of the Laplace rows, those of the skin almost dropped.

    Attributes:
        skin: What is left of the weight of the skin's rows; with 0 they are dropped
            and the field is not determined where nothing was measured [–].
    """

    skin: float = 1e-3

    name = "laplace_free_surface"
    formula = "‖L p − b‖² without the skin's rows"

    def __post_init__(self) -> None:
        """Validate weight and share.

        Raises:
            InputError: The weight or the skin's share is not usable.
        """
        super().__post_init__()
        if not (math.isfinite(self.skin) and 0.0 <= self.skin <= 1.0):
            raise InputError(f"skin must lie between 0 and 1, got {self.skin}")

    def rows(self) -> AffineRows:
        """L and b with the skin's rows scaled by √skin."""
        scene = self.scene
        scale = np.ones(scene.n_voxels)
        scale[free_skin(scene.voxmap.on_surface).reshape(-1)] = math.sqrt(self.skin)
        rows = sp.csr_array(sp.diags_array(scale) @ scene.L)
        rows.eliminate_zeros()
        tags = frozenset({LaplaceRows("p", scale)} if self.skin > 0.0 else ())
        return AffineRows({"p": rows}, scale * scene.b, tags)


def free_skin(on_surface: np.ndarray) -> np.ndarray:
    """The skin without the skin of both ends, shape (n_r, n_theta, n_z)."""
    skin = on_surface.copy()
    skin[:, :, [0, -1]] = False
    skin[[0, -1]] = False
    return skin
