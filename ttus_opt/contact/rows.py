"""Contact rows: force and torque as linear maps of the field (paper eqs. 6, 7).

For each pose, the shell points inside the patient sample the field in one of two
ways, both linear in p (docs/method.md, Contact rows):

- ``voxel-mean`` (the paper): f = Σ_v n̄(v) p(v), with n̄(v) the mean of the normals of
  the points in voxel v, and τ = Σ_v w̄(v) p(v) with w̄(v) the mean of their r×n̂;
  points too near to the surface to sample their voxel do not count in its means.
- ``trilinear``: f = Σ_m (a_m/A₀) n̂_m p(x_m), p(x_m) interpolated, A₀ = 1 cm².

What a point samples is said in `ttus_opt.voxmap.depth_sampling`; the rows here and the
frames of `ttus_opt.haptic.renderer` are both made from it, so that ``render(pose) ==
N(pose) p``. Beyond the inner layer the field continues with that layer's values. Points
outside the patient, or beyond the grid's ends along z, sample nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.arrays import Array
from ttus_opt.compiled import compiled
from ttus_opt.cylindrical import turn_angle as turn_angle
from ttus_opt.errors import InputError
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.pose import rotations
from ttus_opt.scan.radius_lookup import RadiusLayout, radius_between, radius_cell
from ttus_opt.voxmap.depth_sampling import nearest_voxel, spoke_samples, spoke_table
from ttus_opt.voxmap.grid import GridLimits
from ttus_opt.voxmap.voxmap import Voxmap

Sampling = Literal["voxel-mean", "trilinear"]

#: Area to which the trilinear sampling refers, A₀ = 1 cm² [m²]
REFERENCE_AREA = 1e-4


@dataclass(frozen=True)
class ContactRows:
    """Measurement matrices of a trajectory of T poses.

    Rows 3t, 3t+1, 3t+2 are x, y, z of pose t. N and W share their column indices.

    Attributes:
        N: Force rows, f = N p, shape (3T, V).
        W: Torque rows about the shell's reference point, τ = W p, (3T, V) [m].
        contact_points: Shell points inside the patient, shape (T,) [–].
        in_grid: False where no shell point lies within the grid, shape (T,).
        beyond_inner: Points in contact that lie beyond the inner layer, where the
            field continues with that layer's values, shape (T,) [–].
    """

    N: sp.csr_array = field(repr=False)
    W: sp.csr_array = field(repr=False)
    contact_points: NDArray[np.int64]
    in_grid: NDArray[np.bool_]
    beyond_inner: NDArray[np.int64]


def checked_sampling(sampling: str) -> Sampling:
    """The sampling's name, or a sentence.

    Raises:
        InputError: There is no such sampling.
    """
    if sampling not in get_args(Sampling):
        raise InputError(
            f"sampling must be one of {', '.join(get_args(Sampling))}, got {sampling!r}"
        )
    return sampling  # type: ignore[return-value]


def checked_poses(rotation: Array, position: Array) -> tuple[Array, Array]:
    """Poses as contiguous arrays (T, 3, 3) and (T, 3), rounding corrected.

    Raises:
        InputError: Shapes, values that are not finite, or no rotation matrices.
    """
    rotation = np.ascontiguousarray(rotation, dtype=np.float64)
    position = np.ascontiguousarray(position, dtype=np.float64)
    if position.ndim != 2 or position.shape[1] != 3:
        raise InputError(f"positions must be (T, 3) [m], got {position.shape}")
    if rotation.shape != (len(position), 3, 3):
        raise InputError(
            f"rotations must be ({len(position)}, 3, 3), got {rotation.shape}"
        )
    if not np.isfinite(position).all():
        raise InputError("positions contain NaN or infinite values: drop those frames")
    return np.ascontiguousarray(rotations(rotation)), position


def contact_rows(
    voxmap: Voxmap,
    shell: PointShell,
    rotation: Array,
    position: Array,
    *,
    sampling: str = "voxel-mean",
) -> ContactRows:
    """Make N and W for a whole trajectory at once.

    Args:
        voxmap: Grid and surface.
        shell: The probe's point shell.
        rotation: Probe to patient, shape (T, 3, 3) [–].
        position: Of the probe frame's origin, patient frame, shape (T, 3) [m].
        sampling: ``voxel-mean`` or ``trilinear``.

    Returns:
        The rows.

    Raises:
        InputError: Unknown sampling or unusable poses.
    """
    rotation, position = checked_poses(rotation, position)
    grid, surface = voxmap.grid, voxmap.surface
    indptr, indices, values, *counts = _pose_rows(
        checked_sampling(sampling) == "trilinear",
        rotation,
        position,
        *shell_arrays(shell),
        grid.kernel_limits,
        np.array(grid.shape),
        np.ascontiguousarray(surface.radius),
        surface.kernel_layout,
        spoke_table(voxmap),
    )
    shape = (3 * len(position), grid.n_voxels)
    # the three rows of a pose have the same columns
    lengths = np.repeat(np.diff(indptr), 3)
    row_ptr = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
    columns, force, torque = _spread(indptr, indices, values)
    matrices = []
    for data in (force, torque):
        matrix = sp.csr_array((data, columns, row_ptr), shape=shape)
        matrix.has_sorted_indices = True
        matrices.append(matrix)
    return ContactRows(matrices[0], matrices[1], *counts)


def shell_arrays(shell: PointShell) -> tuple[Array, Array, Array, Array]:
    """Shell for the kernels: points, normals (M, 3), a/A₀ (M,), reference (3,)."""
    return (
        np.ascontiguousarray(shell.points),
        np.ascontiguousarray(shell.normals),
        shell.areas / REFERENCE_AREA,
        np.ascontiguousarray(shell.reference),
    )


@compiled(inline="always")
def rotated(R: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """R times a vector (compiled)."""
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@compiled(inline="always")
def within(radius_squared: float, z: float, limits: GridLimits) -> bool:
    """Whether a place lies within the outer layer and the slices (compiled)."""
    if z < limits.z_min:
        return False
    return not (radius_squared > limits.r_outer * limits.r_outer or z > limits.z_max)


# Loops over entries here, no assignments of whole arrays and no numpy sort: each of
# those costs the compiler seconds, and a fit waits for them the first time.


@compiled()
def _grown(
    indices: NDArray[np.int32], values: Array, used: int, need: int
) -> tuple[NDArray[np.int32], Array]:
    """The same with room for more, copied only where there is none (compiled)."""
    if need <= indices.size:
        return indices, values
    size = max(2 * indices.size, need)
    more, more_values = np.empty(size, dtype=np.int32), np.empty((size, 6))
    for a in range(used):
        more[a] = indices[a]
        for c in range(6):
            more_values[a, c] = values[a, c]
    return more, more_values


@compiled()
def _sort(keys: NDArray[np.int32], order: NDArray[np.int64], count: int) -> None:
    """Make ``order`` the order in which keys ascend, by heap sort (compiled)."""
    for a in range(count):
        order[a] = a
    start, end = count // 2, count
    while end > 1:
        if start > 0:
            start -= 1
        else:
            end -= 1
            order[0], order[end] = order[end], order[0]
        root, child = start, 2 * start + 1
        moved = order[root]
        while child < end:
            if child + 1 < end and keys[order[child]] < keys[order[child + 1]]:
                child += 1
            if keys[order[child]] <= keys[moved]:
                break
            order[root] = order[child]
            root, child = child, 2 * child + 1
        order[root] = moved


@compiled()
def _pose_rows(
    trilinear: bool,
    rotation: Array,
    position: Array,
    points: Array,
    normals: Array,
    weights: Array,
    reference: Array,
    limits: GridLimits,
    shape: NDArray[np.int64],
    radius: Array,
    layout: RadiusLayout,
    spokes: Array,
) -> tuple[
    NDArray[np.int32],
    NDArray[np.int32],
    Array,
    NDArray[np.int64],
    NDArray[np.bool_],
    NDArray[np.int64],
]:
    """Rows of all poses, one list of voxels per pose (compiled).

    Returns:
        indptr (T+1,), voxels (nnz,), their force and torque entries (nnz, 6),
        points in contact (T,), whether the shell meets the grid (T,), points in
        contact beyond the inner layer (T,).
    """
    n_poses, n_points = len(position), len(points)
    (n_theta, n_z), skin = radius.shape, radius.reshape(-1)
    indptr = np.zeros(n_poses + 1, dtype=np.int32)
    indices = np.empty(1024, dtype=np.int32)
    values = np.empty((1024, 6))
    contact_points = np.zeros(n_poses, dtype=np.int64)
    beyond_inner = np.zeros(n_poses, dtype=np.int64)
    in_grid = np.zeros(n_poses, dtype=np.bool_)
    # slot: where a voxel stands in this pose's list, -1 when it does not
    slot = np.full(shape[0] * shape[1] * shape[2], -1, dtype=np.int32)
    touched = np.empty(8 * n_points, dtype=np.int32)
    sums = np.empty((8 * n_points, 6))
    hits, order = np.empty(8 * n_points), np.empty(8 * n_points, dtype=np.int64)
    voxels, shares = np.empty(8, dtype=np.int64), np.empty(8)
    limit = radius.max() ** 2
    for t in range(n_poses):
        R, at, count = rotation[t], position[t], 0
        for m in range(n_points):
            x, y, z = rotated(R, points[m, 0], points[m, 1], points[m, 2])
            x, y, z = x + at[0], y + at[1], z + at[2]
            square = x * x + y * y
            if not within(square, z, limits):
                continue
            in_grid[t] = True
            if square >= limit:
                continue
            r, theta = math.sqrt(square), turn_angle(x, y)
            here, after, a, b = radius_cell(theta, z, n_theta, n_z, layout)
            depth = radius_between(here, after, a, b, skin) - r
            if depth <= 0.0:
                continue
            contact_points[t] += 1
            if r < limits.r_inner:
                beyond_inner[t] += 1
            weight = weights[m] if trilinear else 1.0
            if trilinear:
                n_samples = spoke_samples(
                    theta, z, depth, limits, shape, spokes, voxels, shares
                )
            else:
                voxels[0], samples = nearest_voxel(
                    r, theta, z, depth, limits, shape, spokes
                )
                shares[0], n_samples = 1.0, 1 if samples else 0
            for e in range(n_samples):
                c = slot[voxels[e]]
                if c < 0:
                    c, count = count, count + 1
                    slot[voxels[e]], touched[c] = c, voxels[e]
                    hits[c] = 0.0
                    for entry in range(6):
                        sums[c, entry] = 0.0
                hits[c] += 1.0
                _add(sums[c], weight * shares[e], R, points[m], normals[m], reference)
        used = indptr[t]
        indices, values = _grown(indices, values, used, used + count)
        _sort(touched, order, count)
        for a in range(count):
            c = order[a]
            slot[touched[c]] = -1
            indices[used + a] = touched[c]
            for e in range(6):
                values[used + a, e] = sums[c, e] if trilinear else sums[c, e] / hits[c]
        indptr[t + 1] = used + count
    used = indptr[n_poses]
    return (
        indptr,
        indices[:used],
        values[:used],
        contact_points,
        in_grid,
        beyond_inner,
    )


@compiled(inline="always")
def _add(
    row: Array, weight: float, R: Array, point: Array, normal: Array, reference: Array
) -> None:
    """Add weight·(n̂, r×n̂) of one shell point, patient axes, to a row (compiled)."""
    nx, ny, nz = rotated(R, normal[0], normal[1], normal[2])
    lx, ly, lz = rotated(
        R, point[0] - reference[0], point[1] - reference[1], point[2] - reference[2]
    )
    row[0] += weight * nx
    row[1] += weight * ny
    row[2] += weight * nz
    row[3] += weight * (ly * nz - lz * ny)
    row[4] += weight * (lz * nx - lx * nz)
    row[5] += weight * (lx * ny - ly * nx)


@compiled()
def _spread(
    indptr: NDArray[np.int32], indices: NDArray[np.int32], values: Array
) -> tuple[NDArray[np.int32], Array, Array]:
    """One list of voxels per pose into three CSR rows per pose (compiled)."""
    columns = np.empty(3 * indices.size, dtype=np.int32)
    force = np.empty(3 * indices.size)
    torque = np.empty(3 * indices.size)
    for t in range(indptr.size - 1):
        low, high = indptr[t], indptr[t + 1]
        count = high - low
        for c in range(3):
            start = 3 * low + c * count
            for a in range(count):
                columns[start + a] = indices[low + a]
                force[start + a] = values[low + a, c]
                torque[start + a] = values[low + a, 3 + c]
    return columns, force, torque
