"""Voxmap PointShell: two bits per voxel and a plane through the voxel's centre.

Voxels are free, surface or interior. A point of the probe in a surface voxel meets a
plane through the voxel's centre, perpendicular to the point's normal n̂ (into the
probe); below that plane it pushes by Hooke's law (the tangent-plane force):

    d = n̂·(c − x),   f = k Σ_m max(d_m, 0) n̂_m.

Source: W. A. McNeely, K. D. Puterbaugh, J. J. Troy, Six degree-of-freedom haptic
rendering using voxel sampling, SIGGRAPH 1999, 401–408, section 4. There a virtual
coupling keeps the points within the surface layer. Measured poses on soft tissue are
deeper: here a point in an interior voxel takes the plane of the nearest surface voxel.
Points are weighted by their areas. The force jumps where a point crosses a voxel's
face, by up to k times the voxel's edge, as in the source.
"""

from __future__ import annotations

import math
from typing import Unpack

import numpy as np
from numpy.typing import NDArray

from ttus_opt.comparators.base import Given, OneStiffness
from ttus_opt.comparators.contact_geometry import wrench_of
from ttus_opt.core.arguments import expect_positive
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.scan.surface import Surface

#: Edge of a voxel [m]
EDGE = 0.003

#: The two bits of a voxel
FREE, INTERIOR, SURFACE = 0, 1, 2

#: Most voxels [–]
MOST_VOXELS = 20_000_000


class VoxmapPointShell(OneStiffness):
    """Tangent-plane forces of cubic voxels, one stiffness.

    Attributes:
        edge: Edge of the voxels [m].
        voxels: `FREE`, `INTERIOR` or `SURFACE`, shape (n_x, n_y, n_z).
        corner: Centre of the first voxel, patient frame, shape (3,) [m].
    """

    name = "voxmap_point_shell"
    summary = "2-bit voxels, tangent-plane force (McNeely, Puterbaugh, Troy 1999)"
    continuous = False
    turns = False  # voxels lie along the patient's axes

    def __init__(self, *, edge: float = EDGE, **given: Unpack[Given]) -> None:
        from scipy.ndimage import distance_transform_edt

        super().__init__(**given)
        expect_positive(edge, "the edge of a voxel", "m")
        self.edge = edge
        self.corner, self.voxels = _voxelised(self.surface, edge)
        # indices of the nearest surface voxel of every voxel, (3, n_x, n_y, n_z)
        nearest = distance_transform_edt(
            self.voxels != SURFACE, return_distances=False, return_indices=True
        )
        self._plane = np.asarray(nearest, dtype=np.int16)

    def _unit_wrench(self, R: Array, at: Array) -> tuple[Array, int]:
        reference = R @ self.shell.reference + at
        arm = (self.shell.points - self.shell.reference) @ R.T
        place = (reference + arm - self.corner) / self.edge
        # beyond its ends the patient continues with the last slice
        place[:, 2] = np.clip(place[:, 2], 0.0, self.voxels.shape[2] - 1.0)
        voxel = np.rint(place).astype(np.int64)
        within = ((voxel >= 0) & (voxel < self.voxels.shape)).all(axis=1)
        hit = np.flatnonzero(within)
        hit = hit[self.voxels[tuple(voxel[hit].T)] != FREE]
        at_voxel = voxel[hit]
        centre = np.stack([axis[tuple(at_voxel.T)] for axis in self._plane], axis=1)
        inward = self.shell.normals[hit] @ R.T
        above = self.edge * (centre - place[hit])
        depth = np.maximum(np.einsum("ki,ki->k", inward, above), 0.0)
        forces = (depth * self.shell.areas[hit])[:, None] * inward
        return wrench_of(forces, arm[hit]), int(np.count_nonzero(depth))


def _voxelised(surface: Surface, edge: float) -> tuple[Array, NDArray[np.uint8]]:
    """Corner and voxels; surface voxels are interior ones next to a free one."""
    from scipy.ndimage import binary_erosion

    reach = float(surface.radius.max()) + 2.0 * edge
    half = math.ceil(reach / edge)
    n_z = math.ceil((surface.z[-1] - surface.z[0]) / edge) + 1
    if (2 * half + 1) ** 2 * n_z > MOST_VOXELS:
        raise InputError(
            f"voxels of {1e3 * edge:.3g} mm would be more than {MOST_VOXELS}: choose a "
            "larger edge"
        )
    across = edge * np.arange(-half, half + 1)
    x, y = np.meshgrid(across, across, indexing="ij")
    z = surface.z[0] + edge * np.arange(n_z)
    r, theta = np.hypot(x, y)[..., None], np.arctan2(y, x)[..., None]
    inside = r < surface.radius_at(theta, z)
    layers = np.pad(inside, ((0, 0), (0, 0), (1, 1)), mode="edge")
    deep = binary_erosion(layers)[:, :, 1:-1]
    voxels = np.where(inside, np.where(deep, INTERIOR, SURFACE), FREE).astype(np.uint8)
    return np.array([-half * edge, -half * edge, surface.z[0]]), voxels
