"""Growth with depth along every spoke.

Of two neighbours on a spoke, the deeper voxel exceeds the shallower one by at least
``least_slope`` times their distance. Pairs lie inside, or between inside and the
surface layer, whose value belongs to the true radius unless the voxmap is a staircase.
Pairs of two given boundary values are left out.

See docs/method/formulations.md, The shelf.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arguments import expect_not_negative
from ttus_opt.problem.constraints.base import Constraint, LinearRows
from ttus_opt.voxmap.voxmap import INSIDE, SURFACE


@dataclass(frozen=True)
class Monotone(Constraint):
    """The field does not decrease towards the inside along a spoke.

    Attributes:
        least_slope: s, least growth with depth [unit of p per m].
    """

    least_slope: float = 0.0

    name = "monotone"

    @property
    def formula(self) -> str:
        """The formula with the least slope."""
        least = "0" if self.least_slope == 0.0 else f"{self.least_slope:g}/m · Δr"
        return f"p_deeper − p_shallower ≥ {least} along spokes, inside"

    def __post_init__(self) -> None:
        """Refuse a slope that is negative or not finite."""
        expect_not_negative(self.least_slope, "least_slope", "unit/m")

    def rows(self) -> LinearRows:
        """One row per pair, sorted by the deeper voxel."""
        voxmap = self.scene.voxmap
        grid, region = voxmap.grid, voxmap.region
        fixed = voxmap.dirichlet
        deep, shallow = region[:-1], region[1:]
        pair = (deep == INSIDE) & ((shallow == INSIDE) | (shallow == SURFACE))
        pair &= ~(fixed[:-1] & fixed[1:])
        deeper = np.flatnonzero(pair)  # rows of r[:-1] keep their flat index
        m = len(deeper)
        columns = np.stack([deeper, deeper + grid.strides[0]], axis=1).reshape(-1)
        rows = sp.csr_array(
            (np.tile([1.0, -1.0], m), columns, 2 * np.arange(m + 1)),
            shape=(m, grid.n_voxels),
        )
        distance = np.full(grid.n_voxels, grid.r_step)
        links = voxmap.cut_links
        outwards = links.neighbours == links.voxels + grid.strides[0]
        distance[links.voxels[outwards]] /= links.factors[outwards]
        lower = self.least_slope * distance[deeper]
        return LinearRows({"p": rows}, lower, np.full(m, np.inf))
