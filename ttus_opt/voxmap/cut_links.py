"""Links of voxels to the surface layer, and where the surface cuts them.

With φ = (R − r)/Δr at every voxel, positive inside, the field is about proportional to
φ near the surface. So a link from a free voxel a to a voxel b of the surface layer
meets the value of the surface at the part φ_a/(φ_a − φ_b) of its way, and conducts

    1 − φ_b/φ_a

times what it conducts to a value at b itself: ghost values, eliminated (F. Gibou,
R. Fedkiw, L.-T. Cheng, M. Kang, J. Comput. Phys. 176, 2002, 205-227). The voxels of the
layer being the nearest to the surface, |φ_a| > ½: along r a link is ½ to 1½ steps long
and no factor is large, however near to the surface a centre lies. Second order in the
field, and as the factor belongs to the link, the operator stays symmetric.

Links to the wall of a sector have the factor 0: nothing flows through its sides.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ttus_opt.arrays import Array, IntArray

#: |φ_a| is taken for this much at least [–]. Where a region is that of its surface it
#: is above ½ and nothing changes. A decoded field has the sender's region beside a
#: rounded surface: both ends predict with the same links, and what the prediction
#: lacks is sent. A scene over such a voxmap warns (`CutLinks.misplaced`)
LEAST_DEPTH = 0.25


@dataclass(frozen=True)
class CutLinks:
    """Links from voxels inside or outside to voxels of the surface layer.

    Attributes:
        voxels: Flat indices of a, shape (k,).
        neighbours: Flat indices of b, shape (k,).
        axes: 0, 1 or 2 for a link along r, θ or z, shape (k,).
        factors: What multiplies the link's conductance, not negative, shape (k,) [–].
        misplaced: Links whose free voxel lies nearer to the surface than any does where
            the region is that of the surface.
    """

    voxels: IntArray = field(repr=False)
    neighbours: IntArray = field(repr=False)
    axes: IntArray = field(repr=False)
    factors: Array = field(repr=False)
    misplaced: int = 0

    @classmethod
    def none(cls) -> CutLinks:
        """No link at all."""
        nothing = np.zeros(0, dtype=np.int64)
        return cls(nothing, nothing, nothing, np.zeros(0))

    @classmethod
    def of(
        cls, region: NDArray[np.int8], place: Array, wall: int | None = None
    ) -> CutLinks:
        """Find the links around a surface layer, those between Dirichlet voxels too.

        Args:
            region: Above, at and below zero inside, on and outside the surface layer,
                shape (n_r, n_theta, n_z).
            place: Of the surface, (R − r_inner)/Δr, shape (n_theta, n_z) [layers].
            wall: Spoke through whose links nothing flows; it is in the layer.
        """
        shape = region.shape
        layer = np.nonzero(region == 0)
        found, misplaced = [], 0
        for axis in range(3):
            for step in (1, -1):
                at = [np.array(n) for n in layer]
                at[axis] = at[axis] + step
                if axis == 1:
                    at[axis] %= shape[axis]
                there = (at[axis] >= 0) & (at[axis] < shape[axis])
                b = tuple(n[there] for n in layer)
                a = tuple(n[there] for n in at)
                free = region[a] != 0
                a, b = (tuple(n[free] for n in v) for v in (a, b))
                own, other = (place[v[1], v[2]] - v[0] for v in (a, b))
                side = np.sign(region[a])
                misplaced += int((side * own < LEAST_DEPTH).sum())
                own = side * np.maximum(side * own, LEAST_DEPTH)
                # outside a wall may lean over: then nothing flows
                factor = np.maximum(1.0 - other / own, 0.0)
                factor[b[1] == wall] = 0.0
                links = (
                    np.ravel_multi_index(a, shape),
                    np.ravel_multi_index(b, shape),
                    np.full(len(own), axis),
                    factor,
                )
                found.append(links)
        voxels, neighbours, axes, factors = map(
            np.concatenate, zip(*found, strict=True)
        )
        return cls(voxels, neighbours, axes, factors, misplaced)

    def only(self, kept: NDArray[np.bool_]) -> CutLinks:
        """Some of the links, shape (k,)."""
        return CutLinks(
            self.voxels[kept],
            self.neighbours[kept],
            self.axes[kept],
            self.factors[kept],
        )
