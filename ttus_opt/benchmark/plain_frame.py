"""A haptic frame written straightforwardly: what the compiled one is measured against.

`numpy_frame` is whole-array numpy; `LoopFrame` is the same as one compiled loop over
all points. Neither sorts, skips or keeps anything; both are references for
`ttus_opt.haptic.renderer`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ttus_opt.arrays import Array
from ttus_opt.benchmark.plain_assembly import plain_samples
from ttus_opt.compiled import compiled
from ttus_opt.contact.rows import (
    REFERENCE_AREA,
    rotated,
    shell_arrays,
    turn_angle,
    within,
)
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.scan.radius_lookup import RadiusLayout, radius_between, radius_cell
from ttus_opt.voxmap.depth_sampling import nearest_voxel, spoke_samples, spoke_table
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.grid import GridLimits


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
    points = shell.points @ rotation.T + position
    inside, voxels, shares = plain_samples(field.voxmap, points, field.sampling)
    weight = (shares * field.values.reshape(-1)[voxels]).sum(axis=1)
    if field.sampling == "trilinear":
        weight *= shell.areas[inside] / REFERENCE_AREA
    normals = shell.normals[inside] @ rotation.T
    moments = np.cross((shell.points[inside] - shell.reference) @ rotation.T, normals)
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
            spoke_table(voxmap),
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
    limits: GridLimits,
    shape: NDArray[np.int64],
    radius: Array,
    layout: RadiusLayout,
    spokes: Array,
    values: Array,
    hits: NDArray[np.int32],
    wrench: Array,
) -> None:
    """Sum one pose's wrench; ``hits`` is zero before and after (compiled)."""
    n_theta, n_z = radius.shape
    voxels = np.full(len(points), -1)
    pressure = np.zeros(len(points))
    sampled, shares = np.empty(8, dtype=np.int64), np.empty(8)
    for m in range(len(points)):
        x, y, z = rotated(R, points[m, 0], points[m, 1], points[m, 2])
        x, y, z = x + at[0], y + at[1], z + at[2]
        square = x * x + y * y
        if not within(square, z, limits):
            continue
        r, theta = math.sqrt(square), turn_angle(x, y)
        here, after, a, b = radius_cell(theta, z, n_theta, n_z, layout)
        depth = radius_between(here, after, a, b, radius.reshape(-1)) - r
        if depth <= 0.0:
            continue
        if trilinear:
            for e in range(
                spoke_samples(theta, z, depth, limits, shape, spokes, sampled, shares)
            ):
                pressure[m] += shares[e] * values[sampled[e]] * weights[m]
        else:
            voxel, samples = nearest_voxel(r, theta, z, depth, limits, shape, spokes)
            if samples:
                voxels[m], pressure[m] = voxel, values[voxel]
                hits[voxel] += 1
    for m in range(len(points)):
        p = pressure[m]
        if voxels[m] >= 0:
            p /= hits[voxels[m]]
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
