"""A haptic frame in whole-array numpy, the reference for the compiled one.

`plain_samples` is a direct implementation of the sampling in
`ttus_opt.voxmap.depth_sampling`, pose by pose, without sorting, culling or caching.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ttus_opt.contact.contact_size import size_factors
from ttus_opt.contact.rows import REFERENCE_AREA
from ttus_opt.core.arrays import Array
from ttus_opt.probe.cylindrical import cylindrical
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.sampling import least_length
from ttus_opt.voxmap.voxmap import Voxmap, surface_layer


def numpy_frame(
    field: PotentialField, shell: PointShell, rotation: Array, position: Array
) -> Array:
    """Wrench of one pose in whole-array numpy.

    Args:
        field: The field.
        shell: The probe.
        rotation: Probe to patient, shape (3, 3) [–].
        position: Origin of the probe frame, shape (3,) [m].

    Returns:
        Force and torque, patient axes, shape (6,) [N, N·m].
    """
    points = shell.points @ rotation.T + position
    by_area = field.sampling != "voxel-mean"
    inside, voxels, shares = plain_samples(field.voxmap, points, field.sampling)
    weight = (shares * field.values.reshape(-1)[voxels]).sum(axis=1)
    if by_area:
        weight *= shell.areas[inside] / REFERENCE_AREA
    if least := least_length(field.sampling):
        pose = rotation[None], position[None]
        weight *= size_factors(field.voxmap, shell, *pose, least)[0]
    normals = shell.normals[inside] @ rotation.T
    moments = np.cross((shell.points[inside] - shell.reference) @ rotation.T, normals)
    return np.concatenate([weight @ normals, weight @ moments])


def plain_samples(
    voxmap: Voxmap, points: Array, sampling: str
) -> tuple[NDArray[np.bool_], NDArray[np.int64], Array]:
    """Voxels and weights that points sample (`ttus_opt.voxmap.depth_sampling`).

    Args:
        voxmap: Grid and surface.
        points: Patient frame, shape (M, 3) [m].
        sampling: ``voxel-mean`` or ``trilinear``.

    Returns:
        Mask of points inside, shape (M,); their voxels and weights, shape (m, 1) or
        (m, 8), a weight of 0 for voxels that are not sampled.
    """
    grid = voxmap.grid
    r, theta, z = cylindrical(points)
    inside = (r <= grid.r_outer) & (z >= grid.z_min) & (z <= grid.z_max)
    inside[inside] = r[inside] < voxmap.surface.radius_at(theta[inside], z[inside])
    r, theta, z = r[inside], theta[inside], z[inside]
    depth = voxmap.surface.radius_at(theta, z) - r
    v, w = theta / grid.theta_step, (z - grid.z_min) / grid.z_step
    if sampling == "voxel-mean":
        return inside, *_voxel_means(voxmap, r, v, w, depth)
    j = np.minimum(v.astype(int), grid.shape[1] - 1)
    k = np.minimum(w.astype(int), grid.shape[2] - 2)
    voxels, shares = [], []
    for dj, dk in ((0, 0), (0, 1), (1, 0), (1, 1)):
        turn, height = (j + dj) % grid.shape[1], k + dk
        part = np.abs(1 - dj - (v - j)) * np.abs(1 - dk - (w - k))
        layers, along = _along_spoke(voxmap, turn, height, depth)
        for layer, share in zip(layers, along, strict=True):
            voxels.append(np.ravel_multi_index((layer, turn, height), grid.shape))
            shares.append(part * share)
    return inside, np.stack(voxels, axis=1), np.stack(shares, axis=1)


def _surface_of(
    voxmap: Voxmap, j: NDArray[np.int64], k: NDArray[np.int64]
) -> tuple[Array, NDArray[np.int64]]:
    """Radius of the surface on spokes [m], and the layer below the surface layer."""
    grid = voxmap.grid
    radius = voxmap.surface.radius_at(grid.theta[j], grid.z[k])
    return radius, surface_layer(grid, radius) - 1


def _along_spoke(
    voxmap: Voxmap, j: NDArray[np.int64], k: NDArray[np.int64], depth: Array
) -> tuple[tuple[NDArray[np.int64], NDArray[np.int64]], tuple[Array, Array]]:
    """Two layers on spokes (m,) and their weights, at depths (m,) [m]."""
    grid = voxmap.grid
    radius, last = _surface_of(voxmap, j, k)
    place = np.maximum(radius - depth, grid.r_inner)
    near = place >= grid.r[last]
    lower = np.minimum(((place - grid.r_inner) / grid.r_step).astype(int), last)
    upper = np.where(near, last, lower + 1)
    share = np.where(near, 0.0, (place - grid.r[lower]) / grid.r_step)
    to_surface = (radius - place) / (radius - grid.r[last])
    return (lower, upper), (np.where(near, to_surface, 1.0 - share), share)


def _voxel_means(
    voxmap: Voxmap, r: Array, v: Array, w: Array, depth: Array
) -> tuple[NDArray[np.int64], Array]:
    """Nearest voxels and weights in their means, shape (m, 1)."""
    grid = voxmap.grid
    u = np.maximum((r - grid.r_inner) / grid.r_step, 0.0)
    i, j, k = (np.floor(x + 0.5).astype(int) for x in (u, v, w))
    j %= grid.shape[1]
    radius, last = _surface_of(voxmap, j, k)
    face = grid.r[last] + grid.r_step / 2  # the inner face of the surface layer
    samples = (i <= last) & (radius - depth < face)
    voxel = np.ravel_multi_index((i, j, k), grid.shape)
    _, place = np.unique(voxel, return_inverse=True)
    counts = np.bincount(place, weights=samples)[place]
    return voxel[:, None], (samples / np.maximum(counts, 1.0))[:, None]
