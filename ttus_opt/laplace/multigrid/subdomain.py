"""A Dirichlet subdomain: the box of the grid that a preconditioner near voxels needs.

Contact lies under a small part of the surface, and the effect of a load there decays
within a few times its own extent. A V-cycle of the box alone, with zero Dirichlet
values around it, is as good a preconditioner there as one of the whole grid, and costs
the box's share.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.voxmap.grid import CylindricalGrid, nodes_of

Value = TypeVar("Value", bound=np.generic)
Index = NDArray[np.integer]

#: How far a box goes beyond its voxels, over their smaller width on the surface [–],
#: and in voxels at least
REACH, MARGIN = 0.5, 4
#: Spokes of a box are a multiple: an odd number on some level spoils the colouring
SPOKES = 8
#: From this share of the grid on, a box becomes the whole grid [–]
LARGE = 0.7


@dataclass(frozen=True)
class Subdomain:
    """Layers, spokes and slices of a grid; the spokes may pass θ = 0.

    Attributes:
        grid: The grid.
        first: Its first layer, spoke and slice [–].
        shape: Counts (n_r, n_theta, n_z) [–].
    """

    grid: CylindricalGrid
    first: tuple[int, int, int]
    shape: tuple[int, int, int]

    @classmethod
    def around(cls, grid: CylindricalGrid, voxels: Index | None) -> Subdomain:
        """A box around voxels with a margin; the whole grid if that is little larger.

        Args:
            grid: The grid.
            voxels: Flat indices, shape (k,); None for all of the grid.
        """
        whole = cls(grid, (0, 0, 0), grid.shape)
        if voxels is None or not len(voxels):
            return whole
        layers, spokes, slices = nodes_of(voxels, grid.shape)
        start, arc = _arc(spokes, grid.shape[1])
        steps = np.array(
            [grid.r_step, grid.theta_step * grid.r[layers].mean(), grid.z_step]
        )
        reach = REACH * min(arc * steps[1], (np.ptp(slices) + 1) * steps[2])
        margins = [max(math.ceil(reach / step), MARGIN) for step in steps]
        r, width_r = _interval(layers, grid.shape[0], margins[0])
        z, width_z = _interval(slices, grid.shape[2], margins[2])
        start -= margins[1]
        # one more spoke, which stays fixed: the box is not periodic
        width = -(-(arc + 2 * margins[1] + 1) // SPOKES) * SPOKES
        if width >= grid.shape[1]:
            start, width = 0, grid.shape[1]
        if width_r * width * width_z >= LARGE * grid.n_voxels:
            return whole
        return cls(grid, (r, start % grid.shape[1], z), (width_r, width, width_z))

    @property
    def is_whole(self) -> bool:
        """Whether it is the grid itself."""
        return self.shape == self.grid.shape

    @property
    def r(self) -> Array:
        """Radii of its layers, shape (n_r,) [m]."""
        return self.grid.r[self.first[0] : self.first[0] + self.shape[0]]

    @property
    def r_step(self) -> float:
        """Radial step [m]."""
        return self.grid.r_step

    @property
    def theta_step(self) -> float:
        """Angular step [rad]."""
        return self.grid.theta_step

    @property
    def z_step(self) -> float:
        """Step along the axis [m]."""
        return self.grid.z_step

    def restrict(self, values: NDArray[Value]) -> NDArray[Value]:
        """Values of the grid, (n_r, n_theta, n_z), inside the subdomain, a copy."""
        (i, j, k), (n_r, n_theta, n_z) = self.first, self.shape
        spokes = (j + np.arange(n_theta)) % self.grid.shape[1]
        part = values[i : i + n_r, :, k : k + n_z]
        return np.ascontiguousarray(part[:, spokes])

    def free(self, free: Mask) -> Mask:
        """Unknown voxels inside the subdomain, whose rim is fixed."""
        inside = self.restrict(free)
        inside[[0, -1]] = False
        inside[:, :, [0, -1]] = False
        if self.shape[1] < self.grid.shape[1]:
            inside[:, -1] = False
        return inside

    def extend(self, inside: Mask) -> Mask:
        """Mask of the grid, shape (V,), from one of the subdomain."""
        nodes = np.nonzero(inside)
        turned = (nodes[1] + self.first[1]) % self.grid.shape[1]
        marked = np.zeros(self.grid.shape, dtype=np.bool_)
        marked[nodes[0] + self.first[0], turned, nodes[2] + self.first[2]] = True
        return self.grid.flatten(marked)

    def nodes(self, voxels: Index) -> tuple[NDArray[np.int64], ...]:
        """Layer, spoke and slice within the subdomain of voxels that lie in it.

        Args:
            voxels: Flat indices on the grid, shape (k,).

        Returns:
            Three arrays (k,); out of range for voxels outside.
        """
        i, j, k = nodes_of(voxels, self.grid.shape)
        return (
            i - self.first[0],
            (j - self.first[1]) % self.grid.shape[1],
            k - self.first[2],
        )


#: What levels are built on
Box = CylindricalGrid | Subdomain


def _interval(places: Index, count: int, margin: int) -> tuple[int, int]:
    """First place and number of places of an interval around some, with its margin."""
    low = max(int(places.min()) - margin, 0)
    return low, min(int(places.max()) + margin + 1, count) - low


def _arc(spokes: Index, count: int) -> tuple[int, int]:
    """First spoke and number of spokes of the shortest arc over some, no margin."""
    taken = np.unique(spokes)
    gaps = np.diff(taken, append=taken[0] + count)
    widest = int(gaps.argmax())
    return int(taken[(widest + 1) % len(taken)]), count - int(gaps[widest]) + 1
