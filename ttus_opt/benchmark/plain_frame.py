"""A haptic frame written straightforwardly: what the compiled one is measured against.

`numpy_frame` is whole-array numpy; `LoopFrame` is the same as one compiled loop over
all points. Neither sorts, skips or keeps anything; both are references for
`ttus_opt.renderer`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ttus_opt.compiled import compiled
from ttus_opt.contact import (
    REFERENCE_AREA,
    cell_of,
    corner_of,
    nearest_voxel,
    rotated,
    shell_arrays,
    turn_angle,
    within,
)
from ttus_opt.field import PotentialField
from ttus_opt.grid import cylindrical
from ttus_opt.point_shell import PointShell
from ttus_opt.surface import bilinear_radius

Array = NDArray[np.float64]


def numpy_frame(
    field: PotentialField, shell: PointShell, rotation: Array, position: Array
) -> Array:
    """Wrench of one pose in whole-array numpy.

    Args:
        field: The field.
        shell: The probe.
        rotation: Probe to patient, shape (3, 3) [–].
        position: Of the probe frame's origin, shape (3,) [m].

    Returns:
        Force and torque, patient axes, shape (6,) [N, N·m].
    """
    grid, surface = field.voxmap.grid, field.voxmap.surface
    r, theta, z = cylindrical(shell.points @ rotation.T + position)
    inside = (r >= grid.r_inner) & (r <= grid.r_outer)
    inside &= (z >= grid.z_min) & (z <= grid.z_max)
    inside[inside] = r[inside] < surface.radius_at(theta[inside], z[inside])
    r, theta, z = r[inside], theta[inside], z[inside]
    normals = shell.normals[inside] @ rotation.T
    moments = np.cross((shell.points[inside] - shell.reference) @ rotation.T, normals)
    u = (r - grid.r_inner) / grid.r_step
    v, w = theta / grid.theta_step, (z - grid.z_min) / grid.z_step
    if field.sampling == "voxel-mean":
        i, j, k = (np.floor(x + 0.5).astype(int) for x in (u, v, w))
        voxel = np.ravel_multi_index((i, j % grid.shape[1], k), grid.shape)
        _, place, counts = np.unique(voxel, return_inverse=True, return_counts=True)
        weight = field.values.reshape(-1)[voxel] / counts[place]
    else:
        i = np.minimum(u.astype(int), grid.shape[0] - 2)
        j = np.minimum(v.astype(int), grid.shape[1] - 1)
        k = np.minimum(w.astype(int), grid.shape[2] - 2)
        a, b, c = u - i, v - j, w - k
        weight = np.zeros(len(r))
        for di, wi in ((0, 1.0 - a), (1, a)):
            for dj, wj in ((0, 1.0 - b), (1, b)):
                for dk, wk in ((0, 1.0 - c), (1, c)):
                    corner = field.values[i + di, (j + dj) % grid.shape[1], k + dk]
                    weight += wi * wj * wk * corner
        weight *= shell.areas[inside] / REFERENCE_AREA
    return np.concatenate([weight @ normals, weight @ moments])


class LoopFrame:
    """One compiled loop over all points.

    Args:
        field: The field.
        shell: The probe.
    """

    def __init__(self, field: PotentialField, shell: PointShell) -> None:
        voxmap = field.voxmap
        self._trilinear = field.sampling == "trilinear"
        self._fixed = (
            *shell_arrays(shell),
            voxmap.grid.kernel_limits,
            np.array(voxmap.grid.shape),
            np.ascontiguousarray(voxmap.surface.radius),
            voxmap.surface.kernel_layout,
            np.ascontiguousarray(field.values).reshape(-1),
            np.zeros(voxmap.grid.n_voxels, dtype=np.int32),
        )

    def __call__(self, rotation: Array, position: Array) -> Array:
        """Force and torque of one pose, as `numpy_frame` gives them."""
        wrench = np.zeros(6)
        _loop(self._trilinear, rotation, position, *self._fixed, wrench)
        return wrench


@compiled(nogil=True)
def _loop(
    trilinear: bool,
    R: Array,
    at: Array,
    points: Array,
    normals: Array,
    weights: Array,
    reference: Array,
    limits: Array,
    shape: NDArray[np.int64],
    radius: Array,
    layout: Array,
    values: Array,
    hits: NDArray[np.int32],
    wrench: Array,
) -> None:
    """Sum one pose's wrench; ``hits`` is zero before and after (compiled)."""
    voxels = np.full(len(points), -1)
    pressure = np.zeros(len(points))
    for m in range(len(points)):
        x, y, z = rotated(R, points[m, 0], points[m, 1], points[m, 2])
        x, y, z = x + at[0], y + at[1], z + at[2]
        square = x * x + y * y
        if not within(square, z, limits):
            continue
        r, theta = math.sqrt(square), turn_angle(x, y)
        if r >= bilinear_radius(theta, z, radius, layout):
            continue
        if trilinear:
            i, j, j_next, k, u, v, w = cell_of(r, theta, z, limits, shape)
            for corner in range(8):
                voxel, share = corner_of(corner, i, j, j_next, k, u, v, w, shape)
                pressure[m] += share * values[voxel] * weights[m]
        else:
            voxels[m] = nearest_voxel(r, theta, z, limits, shape)
            hits[voxels[m]] += 1
    for m in range(len(points)):
        p, voxel = pressure[m], voxels[m]
        if voxel >= 0:
            p = values[voxel] / hits[voxel]
        nx, ny, nz = rotated(R, normals[m, 0], normals[m, 1], normals[m, 2])
        lx, ly, lz = rotated(
            R,
            points[m, 0] - reference[0],
            points[m, 1] - reference[1],
            points[m, 2] - reference[2],
        )
        wrench[0] += p * nx
        wrench[1] += p * ny
        wrench[2] += p * nz
        wrench[3] += p * (ly * nz - lz * ny)
        wrench[4] += p * (lz * nx - lx * nz)
        wrench[5] += p * (lx * ny - ly * nx)
    for m in range(len(points)):
        if voxels[m] >= 0:
            hits[voxels[m]] = 0
