"""Links of voxels to the surface layer, and where the surface cuts them.

With φ = (R − r)/Δr at every voxel, positive inside, the field is about proportional to
φ near the surface. A link from a free voxel a to a voxel b of the surface layer meets
the surface after the fraction φ_a/(φ_a − φ_b) of its length, and so conducts

    1 − φ_b/φ_a

times as much as to a value at b: eliminated ghost values (F. Gibou, R. Fedkiw, L.-T.
Cheng, M. Kang, J. Comput. Phys. 176, 2002, 205-227). The layer's voxels are the nearest
to the surface, so |φ_a| > ½: along r a link is ½ to 1½ steps long and no factor is
large. The field is second order, and since the factor belongs to the link, the operator
stays symmetric.

Links to the wall of a sector have the factor 0: nothing flows through its sides.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array, IntArray

#: Lower limit of |φ_a| [–]. It is above ½ where regions follow from the surface. A
#: decoded field has the sender's regions with a rounded surface: both ends predict with
#: the same links, and the remainder is sent. A scene on such a voxmap warns
#: (`CutLinks.misplaced`)
LEAST_DEPTH = 0.25


@dataclass(frozen=True)
class CutLinks:
    """Links from voxels inside or outside to voxels of the surface layer.

    Attributes:
        voxels: Flat indices of a, shape (k,).
        neighbours: Flat indices of b, shape (k,).
        axes: 0, 1 or 2 for a link along r, θ or z, shape (k,).
        factors: Factor of the link's conductance, not negative, shape (k,) [–].
        misplaced: Number of links whose |φ_a| is below `LEAST_DEPTH`.
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
        """Find the links around a surface layer, including those to Dirichlet voxels.

        Args:
            region: Above, at and below zero inside, on and outside the surface layer,
                shape (n_r, n_theta, n_z).
            place: Position of the surface (R − r_inner)/Δr, (n_theta, n_z) [layers].
            wall: Spoke of the layer through whose links nothing flows.
        """
        shape = region.shape
        layer = np.nonzero(region == 0)
        cut, misplaced = [], 0
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
                near, other = (place[v[1], v[2]] - v[0] for v in (a, b))
                side = np.sign(region[a])
                misplaced += int((side * near < LEAST_DEPTH).sum())
                near = side * np.maximum(side * near, LEAST_DEPTH)
                # outside, a steep surface may give a negative factor: nothing flows
                factor = np.maximum(1.0 - other / near, 0.0)
                factor[b[1] == wall] = 0.0
                links = (
                    np.ravel_multi_index(a, shape),
                    np.ravel_multi_index(b, shape),
                    np.full(len(near), axis),
                    factor,
                )
                cut.append(links)
        voxels, neighbours, axes, factors = map(np.concatenate, zip(*cut, strict=True))
        return cls(voxels, neighbours, axes, factors, misplaced)

    def only(self, kept: NDArray[np.bool_]) -> CutLinks:
        """Some of the links, shape (k,)."""
        return CutLinks(
            self.voxels[kept],
            self.neighbours[kept],
            self.axes[kept],
            self.factors[kept],
        )
