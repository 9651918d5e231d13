"""Draws of a fit's error near the skin, for the covariance of any contact.

Contact samples only voxels near the skin. Draws are therefore kept down to some depth,
and the covariance of rows is the sample covariance over the draws.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.uncertainty.posterior import Float32Array, kept_rows
from ttus_opt.voxmap.sampling import spoke_table
from ttus_opt.voxmap.voxmap import Voxmap

#: No draws are kept deeper than this [m]
DEEPEST = 1.0

#: Draws multiplied at once
BATCH = 32


@dataclass(frozen=True)
class PosteriorDraws:
    """Draws of the error of a field.

    Attributes:
        values: The draws, shape (count, n) [unit of the field].
        sizes: Draws of ln ℓ₀ of `contact-size`, shape (count,) [–].
        voxels: Voxels of the field's, shape (n,), ascending.
        depth: Depth below the skin down to which they are kept [m].
    """

    values: Float32Array = field(repr=False)
    sizes: Array = field(repr=False)
    voxels: IntArray = field(repr=False)
    depth: float

    def covariance(
        self, rows: sp.csr_array, height: int, sized: Array | None = None
    ) -> Array:
        """Covariance of blocks of rows of a field.

        Args:
            rows: Shape (k · height, V).
            height: Rows of a block [–].
            sized: As of `Posterior.covariance`.

        Returns:
            Shape (k, height, height); NaN where a block touches other voxels.
        """
        near, missing = kept_rows(rows, self.voxels, height)
        count = len(self.values)
        out = np.zeros((rows.shape[0] // height, height, height))
        for start in range(0, count, BATCH):  # only a batch in double precision
            these = slice(start, start + BATCH)
            samples = np.asarray(near @ self.values[these].T)
            if sized is not None:
                samples += np.outer(sized, self.sizes[these])
            samples = samples.reshape(len(out), height, -1)
            out += samples @ samples.transpose(0, 2, 1) / count
        out[missing] = np.nan
        return np.asarray(out)


def skin_voxels(voxmap: Voxmap, depth: float) -> IntArray:
    """Voxels that contact down to some depth samples, shape (n,), ascending.

    Args:
        voxmap: Grid and surface.
        depth: Depth below the surface [m].

    Raises:
        InputError: As in `checked_depth`.
    """
    checked_depth(depth)
    grid = voxmap.grid
    outermost = spoke_table(voxmap)[:, 1].astype(np.int64)
    n_spokes = len(outermost)
    layers = outermost - np.arange(math.ceil(depth / grid.r_step) + 2)[:, None]
    spokes = np.broadcast_to(np.arange(n_spokes), layers.shape)
    inside = layers >= 0
    return np.sort(layers[inside] * n_spokes + spokes[inside])


def checked_depth(depth: float) -> float:
    """Return a valid depth [m].

    Raises:
        InputError: It is not positive, or beyond `DEEPEST`.
    """
    if not 0.0 < depth < DEEPEST:
        raise InputError(
            f"depth must be positive and below {DEEPEST:g} m, got {depth} m"
        )
    return depth
