"""A relative stiffness on a lattice over the skin and a few depths, and its prior.

The depth map p = φ(d) (1 + g) of `ttus_opt.problem.terms.depth_map` has a Gaussian
field g with a separable Matérn covariance. Here g is linear between the nodes of a
lattice: nodes over the skin, `SPACING` of a correlation length apart, times a few
depths. A field is then a few hundred numbers, whatever the voxels.

Interpolation on a regular lattice: A. G. Wilson, H. Nickisch, Kernel interpolation for
scalable structured Gaussian processes, ICML 37 (2015).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.spatial.distance import cdist

from ttus_opt.contact.standing import skin_points
from ttus_opt.core.arguments import expect_positive
from ttus_opt.core.arrays import Array
from ttus_opt.gaussian.matern import matern
from ttus_opt.probe.cylindrical import TURN, lattice_shares
from ttus_opt.problem.terms.depth_profile import voxel_depths
from ttus_opt.voxmap.voxmap import Voxmap

#: Distance of nodes over the skin, over the correlation length [–]: linear
#: interpolation then misses at most 4 % of the variance between nodes
SPACING = 0.4

#: Depths of nodes over the correlation length along the depth [–]; deeper, g is that of
#: the last one
DEPTHS = (0.0, 0.5, 1.1, 2.0)


@dataclass(frozen=True)
class DepthLattice:
    """Nodes, their prior, and how voxels lie between them.

    Node (i, j, k), flat in C order, is at θ = 2π i/n_theta, at the j-th height and the
    k-th depth; the first two form a place.

    Attributes:
        voxmap: Grid and surface.
        surface_length: Correlation length along the skin, ℓ [m].
        depth_length: Correlation length along the depth [m].
        n_theta: Nodes around [–].
        n_z: Nodes along [–].
    """

    voxmap: Voxmap = field(repr=False)
    surface_length: float
    depth_length: float
    n_theta: int
    n_z: int

    @classmethod
    def over(
        cls,
        voxmap: Voxmap,
        surface_length: float,
        depth_length: float,
        places: tuple[int, int] | None = None,
    ) -> DepthLattice:
        """A lattice as fine as the lengths need, or with given places.

        Args:
            voxmap: Grid and surface.
            surface_length: ℓ [m].
            depth_length: Length along the depth [m].
            places: Nodes around and along; by default from the length.

        Raises:
            InputError: A length that is not positive.
        """
        expect_positive(surface_length, "surface_length", "m")
        expect_positive(depth_length, "depth_length", "m")
        grid, step = voxmap.grid, SPACING * surface_length
        around = TURN * float(voxmap.surface.radius.mean())
        fine = (
            max(4, math.ceil(around / step)),
            max(2, math.ceil((grid.z_max - grid.z_min) / step) + 1),
        )
        return cls(voxmap, surface_length, depth_length, *(places or fine))

    @property
    def n_places(self) -> int:
        """Nodes over the skin [–]."""
        return self.n_theta * self.n_z

    @property
    def size(self) -> int:
        """Nodes in all [–]."""
        return self.n_places * len(DEPTHS)

    @cached_property
    def depths(self) -> Array:
        """Depths of the nodes [m]."""
        return self.depth_length * np.array(DEPTHS)

    @property
    def theta(self) -> Array:
        """Angles of the nodes, shape (n_theta,) [rad]."""
        return TURN * np.arange(self.n_theta) / self.n_theta

    @property
    def z(self) -> Array:
        """Heights of the nodes, shape (n_z,) [m]."""
        grid = self.voxmap.grid
        return np.linspace(grid.z_min, grid.z_max, self.n_z)

    @cached_property
    def over_skin(self) -> Array:
        """Correlation of g between places, shape (n_places, n_places) [–]."""
        theta, z = np.meshgrid(self.theta, self.z, indexing="ij")
        flat = skin_points(self.voxmap.surface, theta, z).reshape(-1, 3)
        return matern(cdist(flat, flat), self.surface_length)

    @cached_property
    def over_depth(self) -> Array:
        """Correlation of g between depths, shape (k, k) [–]."""
        away = np.abs(self.depths[:, None] - self.depths)
        return matern(away, self.depth_length)

    @cached_property
    def weights(self) -> sp.csr_array:
        """G at voxels from g at nodes, shape (V, size): at most 8 a row, sum 1."""
        grid = self.voxmap.grid
        theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
        along = (z.ravel() - grid.z_min) / (grid.z_max - grid.z_min)
        spoke = lattice_shares(theta.ravel(), along, (self.n_theta, self.n_z))
        depth = np.clip(voxel_depths(self.voxmap), 0.0, self.depths[-1])
        low = np.clip(np.searchsorted(self.depths, depth) - 1, 0, len(DEPTHS) - 2)
        deep = (depth - self.depths[low]) / np.diff(self.depths)[low]
        n, k = grid.n_voxels, len(DEPTHS)
        places, shares = (np.stack(each) for each in zip(*spoke, strict=True))
        on = np.tile(np.arange(theta.size), grid.shape[0])  # spoke of every voxel
        columns = k * places[:, on, None] + np.stack([low, low + 1], axis=1)
        values = shares[:, on, None] * np.stack([1.0 - deep, deep], axis=1)
        entries = (np.moveaxis(each, 0, 1).ravel() for each in (values, columns))
        shape = (n, self.size)
        return sp.csr_array((*entries, 8 * np.arange(n + 1)), shape=shape)
