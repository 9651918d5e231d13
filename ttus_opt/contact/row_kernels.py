"""Compiled kernels of the contact rows: their arrays, and the loop over poses.

Small functions with scalar loops and without NumPy calls keep the first compilation
short: array assignments, new arrays and NumPy's sort each take seconds to compile.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ttus_opt.contact.slip import Slip, slipping
from ttus_opt.core.arrays import Array
from ttus_opt.core.compiled import compiled
from ttus_opt.probe.cylindrical import TURN, turn_angle
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.scan.radius_lookup import RadiusLayout, radius_between, radius_cell
from ttus_opt.voxmap.grid import GridLimits, around, depth_at
from ttus_opt.voxmap.sampling import nearest_voxel, spoke_samples, spoke_table
from ttus_opt.voxmap.voxmap import Voxmap

#: Area to which the trilinear sampling refers, A₀ = 1 cm² [m²]
REFERENCE_AREA = 1e-4


#: What a walk over the points of poses makes: patches alone, or rows of a sampling too
PATCHES, VOXEL_MEAN, TRILINEAR = 0, 1, 2


class ShellArrays(NamedTuple):
    """A point shell for the kernels.

    Attributes:
        points: Probe frame, shape (M, 3) [m].
        normals: Unit, inward, shape (M, 3).
        areas: a/A₀, shape (M,) [–].
        reference: Reference point of the torque, shape (3,) [m].
    """

    points: Array
    normals: Array
    areas: Array
    reference: Array


def shell_arrays(shell: PointShell) -> ShellArrays:
    """A point shell for the kernels."""
    return ShellArrays(
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
    """Whether a point lies within the outer layer and the slices (compiled)."""
    beyond = radius_squared > limits.r_outer * limits.r_outer
    # branch-free, so that loops can be vectorised
    return not (beyond | (z < limits.z_min) | (z > limits.z_max))


@compiled(inline="always")
def beside(x: float, y: float, limits: GridLimits) -> bool:
    """Whether a point lies outside the sector that the grid covers (compiled)."""
    # on a full turn the angle is not needed
    return limits.width < TURN and around(turn_angle(x, y), limits) > limits.width


class Poses(NamedTuple):
    """Poses of the probe and the sliding of its points.

    Attributes:
        rotation: Probe to patient, shape (T, 3, 3) [–].
        position: Origin of the probe frame, shape (T, 3) [m].
        slip: For rows of drag; `Slip.none` for rows of contact.
    """

    rotation: Array
    position: Array
    slip: Slip


class VoxmapArrays(NamedTuple):
    """A voxmap for the kernels.

    Attributes:
        limits: `CylindricalGrid.kernel_limits`.
        shape: Voxels in r, θ and z, shape (3,) [–].
        radius: Radius at the surface's nodes, flat [m].
        nodes: Number of angles and slices of the surface [–].
        layout: `Surface.kernel_layout`.
        spokes: `spoke_table`.
        highest: Square of the largest radius [m²].
    """

    limits: GridLimits
    shape: NDArray[np.int64]
    radius: Array
    nodes: tuple[int, int]
    layout: RadiusLayout
    spokes: Array
    highest: float

    @classmethod
    def of(cls, voxmap: Voxmap) -> VoxmapArrays:
        """The arrays of a voxmap."""
        radius = np.ascontiguousarray(voxmap.surface.radius)
        return cls(
            voxmap.grid.kernel_limits,
            np.array(voxmap.grid.shape),
            radius.reshape(-1),
            (radius.shape[0], radius.shape[1]),
            voxmap.surface.kernel_layout,
            spoke_table(voxmap),
            float(radius.max()) ** 2,
        )


class Rows(NamedTuple):
    """Rows under construction, three per pose with the same columns.

    Attributes:
        row_ptr: First entry of each row, shape (3T + 1,).
        columns: Voxels, shape (n,).
        force: Entries of N, shape (n,).
        torque: Entries of W, shape (n,) [m].
        contact_points: See `ContactRows`.
        in_grid: See `ContactRows`.
        beyond_inner: See `ContactRows`.
        normal: See `contact_size.Patches`.
        centre: See `contact_size.Patches`.
        spread: See `contact_size.Patches`.
    """

    row_ptr: NDArray[np.int32]
    columns: NDArray[np.int32]
    force: Array
    torque: Array
    contact_points: NDArray[np.int64]
    in_grid: NDArray[np.bool_]
    beyond_inner: NDArray[np.int64]
    normal: Array
    centre: Array
    spread: Array

    @classmethod
    def empty(cls, n_poses: int, size: int) -> Rows:
        """Arrays with space for ``size`` entries."""
        return cls(
            np.zeros(3 * n_poses + 1, np.int32),
            np.empty(size, np.int32),
            np.empty(size),
            np.empty(size),
            np.zeros(n_poses, np.int64),
            np.zeros(n_poses, np.bool_),
            np.zeros(n_poses, np.int64),
            np.zeros((n_poses, 3)),
            np.zeros((n_poses, 3)),
            np.zeros(n_poses),
        )

    def grown(self, rows: int, ratio: float) -> Rows:
        """A larger copy, with space for all poses by extrapolation.

        Args:
            rows: Number of finished rows.
            ratio: Number of all poses over finished ones [–].
        """
        used, size = self.row_ptr[rows], len(self.columns)
        room = max(2 * size, math.ceil(1.2 * ratio * used))
        arrays = []
        for held in (self.columns, self.force, self.torque):
            more = np.empty(room, held.dtype)
            more[:used] = held[:used]
            arrays.append(more)
        columns, force, torque = arrays
        return self._replace(columns=columns, force=force, torque=torque)


class Scratch(NamedTuple):
    """Scratch arrays of the kernel.

    Attributes:
        slot: Index of a voxel in a pose's list, -1 if absent, shape (V,).
        touched: A pose's list of voxels.
        sums: Their force and torque entries, shape (n, 6).
        hits: Number of points that sampled them.
        order: The permutation that sorts them.
        voxels: Voxels that one point samples, shape (8,).
        shares: Their weights, shape (8,).
        own: A point's normal, or its direction of sliding, and lever arm × that,
            patient axes, shape (6,).
        patch: Sums over a pose's points in contact, by area times depth: normals and
            arms from the shell's reference, squares of these, and that weight itself;
            probe frame, shape (8,).
    """

    slot: NDArray[np.int32]
    touched: NDArray[np.int32]
    sums: Array
    hits: Array
    order: NDArray[np.int64]
    voxels: NDArray[np.int64]
    shares: Array
    own: Array
    patch: Array

    @classmethod
    def of(cls, n_voxels: int, n_points: int) -> Scratch:
        """Scratch arrays large enough for any pose."""
        most = 8 * n_points
        return cls(
            np.full(n_voxels, -1, np.int32),
            np.empty(most, np.int32),
            np.empty((most, 6)),
            np.empty(most),
            np.empty(most, np.int64),
            np.empty(8, np.int64),
            np.empty(8),
            np.empty(6),
            np.empty(8),
        )


@compiled(inner=True)
def _sort(keys: NDArray[np.int32], order: NDArray[np.int64], count: int) -> None:
    """Set ``order`` to the permutation that sorts the keys, by heap sort (compiled)."""
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


@compiled(inner=True, forceinline=True)
def _skin(
    theta: float, z: float, nodes: tuple[int, int], layout: RadiusLayout, radius: Array
) -> float:
    """Radius of the surface at (θ, z) (compiled) [m]."""
    here, after, a, b = radius_cell(theta, z, nodes[0], nodes[1], layout)
    skin: float = radius_between(here, after, a, b, radius)
    return skin


@compiled(inner=True, forceinline=True)
def _sample(
    trilinear: bool,
    place: tuple[float, float, float, float],
    limits: GridLimits,
    shape: NDArray[np.int64],
    spokes: Array,
    voxels: NDArray[np.int64],
    shares: Array,
) -> int:
    """Voxels and weights of a point at (r, θ, z) and depth; their number (compiled)."""
    r, theta, z, depth = place
    if trilinear:
        count: int = spoke_samples(
            theta, z, depth, limits, shape, spokes, voxels, shares
        )
        return count
    voxels[0], sampled = nearest_voxel(r, theta, z, depth, limits, shape, spokes)
    shares[0] = 1.0
    return 1 if sampled else 0


@compiled(inner=True, forceinline=True)
def _set_own(
    own: Array, R: Array, shell: ShellArrays, m: int, slip: Slip, t: int
) -> None:
    """Set (n̂, r×n̂) of shell point m, or (t̂, r×t̂), patient axes (compiled)."""
    normal, point, reference = shell.normals[m], shell.points[m], shell.reference
    nx, ny, nz = rotated(R, normal[0], normal[1], normal[2])
    lx, ly, lz = rotated(
        R, point[0] - reference[0], point[1] - reference[1], point[2] - reference[2]
    )
    if len(slip.twist):
        a = slip.twist[t]
        twist = a[0], a[1], a[2], a[3], a[4], a[5]
        nx, ny, nz = slipping((nx, ny, nz), (lx, ly, lz), twist, slip.deadband)
    own[0], own[1], own[2] = nx, ny, nz
    own[3] = ly * nz - lz * ny
    own[4] = lz * nx - lx * nz
    own[5] = lx * ny - ly * nx


@compiled(inner=True, forceinline=True)
def _weigh(weight: float, shell: ShellArrays, m: int, patch: Array) -> None:
    """Add shell point m to the sums of a patch (compiled)."""
    for a in range(3):
        arm = shell.points[m, a] - shell.reference[a]
        patch[a] += weight * shell.normals[m, a]
        patch[3 + a] += weight * arm
        patch[6] += weight * arm * arm
    patch[7] += weight


@compiled(inner=True)
def _keep_patch(t: int, R: Array, patch: Array, rows: Rows) -> None:
    """Write a pose's patch, which is zero without contact (compiled)."""
    n, c, total = patch[:3], patch[3:6], patch[7]
    if total == 0.0:
        return
    mean = (c[0] * c[0] + c[1] * c[1] + c[2] * c[2]) / total
    rows.spread[t] = max(patch[6] - mean, 0.0) / total
    length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    if length == 0.0:
        return
    nx, ny, nz = rotated(R, n[0] / length, n[1] / length, n[2] / length)
    cx, cy, cz = rotated(R, c[0] / total, c[1] / total, c[2] / total)
    rows.normal[t, 0], rows.normal[t, 1], rows.normal[t, 2] = nx, ny, nz
    rows.centre[t, 0], rows.centre[t, 1], rows.centre[t, 2] = cx, cy, cz


@compiled(inner=True, forceinline=True)
def _add(weight: float, n_samples: int, count: int, scratch: Scratch) -> int:
    """Add a point to a pose's list of ``count`` voxels; its new length (compiled)."""
    for e in range(n_samples):
        voxel = scratch.voxels[e]
        c, factor = scratch.slot[voxel], weight * scratch.shares[e]
        if c < 0:
            c = count
            count += 1
            scratch.slot[voxel] = c
            scratch.touched[c] = voxel
            scratch.hits[c] = 0.0
            for entry in range(6):
                scratch.sums[c, entry] = 0.0
        scratch.hits[c] += 1.0
        for entry in range(6):
            scratch.sums[c, entry] += factor * scratch.own[entry]
    return count


@compiled(inner=True)
def _keep(t: int, count: int, trilinear: bool, rows: Rows, scratch: Scratch) -> None:
    """Write a pose's list of voxels as its rows, if there is space (compiled)."""
    start = rows.row_ptr[3 * t]
    has_room = start + 3 * count <= rows.columns.size
    if has_room:
        _sort(scratch.touched, scratch.order, count)
    for a in range(count):
        c = scratch.order[a] if has_room else a
        scratch.slot[scratch.touched[c]] = -1
        if has_room:
            share = 1.0 if trilinear else scratch.hits[c]
            for axis in range(3):
                place = start + axis * count + a
                rows.columns[place] = scratch.touched[c]
                rows.force[place] = scratch.sums[c, axis] / share
                rows.torque[place] = scratch.sums[c, 3 + axis] / share
    for axis in range(1, 4):
        rows.row_ptr[3 * t + axis] = start + axis * count


@compiled()
def pose_rows(
    first: int,
    kind: int,
    poses: Poses,
    shell: ShellArrays,
    v: VoxmapArrays,
    rows: Rows,
    scratch: Scratch,
) -> int:
    """Assemble rows of poses from ``first`` on while there is space (compiled).

    The kind is `PATCHES`, `VOXEL_MEAN` or `TRILINEAR`; the first has no rows. With
    slip, every point pushes along its direction of sliding, not its normal.

    Returns:
        The pose for which there was no space, or the number of poses.
    """
    voxels, shares = scratch.voxels, scratch.shares
    slip, patch, trilinear = poses.slip, scratch.patch, kind == TRILINEAR
    for t in range(first, len(poses.position)):
        R, at = poses.rotation[t], poses.position[t]
        patch[:] = 0.0
        count = int(np.int64(0))  # numba would give a literal its own type
        in_grid, in_contact, beyond = False, 0, 0
        for m in range(len(shell.points)):
            point = shell.points[m]
            x, y, z = rotated(R, point[0], point[1], point[2])
            x, y, z = x + at[0], y + at[1], z + at[2]
            square = x * x + y * y
            if not within(square, z, v.limits) or beside(x, y, v.limits):
                continue
            in_grid = True
            if square >= v.highest:
                continue
            r, theta = math.sqrt(square), turn_angle(x, y)
            skin = _skin(theta, z, v.nodes, v.layout, v.radius)
            depth = depth_at(skin, r, z, v.limits)
            if depth <= 0.0:
                continue
            in_contact += 1
            beyond += 1 if r < v.limits.r_inner else 0
            _weigh(shell.areas[m] * depth, shell, m, patch)
            if kind == PATCHES:
                continue
            place = (r, theta, z, depth)
            n_samples = _sample(
                trilinear, place, v.limits, v.shape, v.spokes, voxels, shares
            )
            if n_samples:
                _set_own(scratch.own, R, shell, m, slip, t)
                weight = shell.areas[m] if trilinear else 1.0
                count = _add(weight, n_samples, count, scratch)
        _keep_patch(t, R, patch, rows)
        _keep(t, count, trilinear, rows, scratch)
        if rows.row_ptr[3 * t + 3] > rows.columns.size:
            return t
        rows.in_grid[t] = in_grid
        rows.contact_points[t] = in_contact
        rows.beyond_inner[t] = beyond
    return len(poses.position)


def walked(voxmap: Voxmap, shell: PointShell, poses: Poses, kind: int) -> Rows:
    """The rows and patches of all poses, which are contiguous arrays."""
    n, rows = len(poses.position), Rows.empty(len(poses.position), 1024)
    sizes = (voxmap.grid.n_voxels, len(shell)) if kind else (0, 0)
    scratch = Scratch.of(*sizes)
    given, done = (poses, shell_arrays(shell), VoxmapArrays.of(voxmap)), 0
    while (done := pose_rows(done, kind, *given, rows, scratch)) < n:
        rows = rows.grown(3 * done, n / (done + 1))
    return rows
