"""The compiled haptic frame: contact of one pose, then the wrench of a field.

Two passes over scratch space, so that nothing is allocated and a second field costs
its second pass only:

- `touch` finds the shell points inside the patient. Blocks away from the surface are
  skipped by their bounding spheres (`ttus_opt.contact.shell_blocks`); the rest goes
  through a loop without branches, which the compiler turns into vector instructions.
  What a point samples comes from the very functions that make the rows of the fit
  (`ttus_opt.voxmap.depth_sampling`), so that both agree to the last voxel.
- `wrench_of` sums the wrench of one field over those points.

All is float64, no fast-math: reordered or fused operations would put points near a
voxel face on different sides in the fit and in the frame.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ttus_opt.arrays import Array, IntArray
from ttus_opt.compiled import compiled
from ttus_opt.contact.rows import rotated, within
from ttus_opt.contact.shell_blocks import Tiles
from ttus_opt.cylindrical import turn_angle
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.scan.radius_lookup import RadiusLayout, radius_between, radius_cell
from ttus_opt.voxmap.depth_sampling import corner_sample, nearest_voxel, spoke_cell
from ttus_opt.voxmap.grid import GridLimits


@compiled(error_model="numpy", nogil=True)
def touch(R: Array, at: Array, s: FrameData) -> tuple[int, bool, int]:
    """Find the points in contact and what each samples (compiled).

    Args:
        R: Rotation, probe to patient, shape (3, 3) [–].
        at: Position, shape (3,) [m].
        s: Probe, surface and scratch; its ``touched``, ``depth``, ``voxel`` and
            ``share`` are written.

    Returns:
        Points in contact, whether the shell meets the grid, and how many of the
        points in contact lie beyond the inner layer.
    """
    # taken out of the tuple once: it counts references on every look
    start, points, place, node = s.start, s.points, s.place, s.node
    n_blocks, room = start.size - 1, place.shape[1]
    near, limits = s.near, _extent(s.limits)
    a, b = s.layout, s.tiles
    layout, tiles = RadiusLayout(a[0], a[1], a[2], a[3]), Tiles(b[0], b[1], b[2], b[3])
    _place(R, at, s.spheres, 0, n_blocks, place)
    _find_near(place, s.spheres[3], limits, s.ceiling, tiles, near)
    contact, beyond, in_grid, first = 0, 0, False, 0
    while first < n_blocks:
        if not near[first]:
            first += 1
            continue
        last = first + 1
        while last < n_blocks and near[last] and start[last + 1] - start[first] <= room:
            last += 1
        low, high = start[first], start[last]
        first = last
        _place(R, at, points, low, high, place)
        _find_nodes(high - low, s.nodes, layout, place, node)
        contact, deeper, met = _select(low, high - low, contact, s)
        in_grid, beyond = in_grid or met, beyond + deeper
    if s.trilinear:
        _find_spokes(contact, s)
    else:
        _find_voxels(contact, s)
    return contact, in_grid or _meets_grid(R, at, s), beyond


@compiled(inline="always")
def _extent(a: Array) -> GridLimits:
    """A grid's limits by name (compiled)."""
    return GridLimits(a[0], a[1], a[2], a[3], a[4], a[5], a[6])


@compiled(inline="always")
def _shifted(
    a: float, b: float, c: float, x: float, y: float, z: float, shift: float
) -> float:
    """One coordinate of R x + t, rounded as `contact.rotated` rounds it (compiled)."""
    return (a * x + b * y + c * z) + shift


@compiled(error_model="numpy", nogil=True)
def _place(
    R: Array, at: Array, points: Array, low: int, high: int, place: Array
) -> None:
    """Points low to high about the axis: r², θ, z, without a branch (compiled)."""
    a, b, c, d, e, f = R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2]
    g, h, i = R[2, 0], R[2, 1], R[2, 2]
    tx, ty, tz = at[0], at[1], at[2]
    xs, ys, zs = points[0, low:high], points[1, low:high], points[2, low:high]
    squares, thetas, heights = place[0], place[1], place[2]
    for m in range(xs.size):
        x = _shifted(a, b, c, xs[m], ys[m], zs[m], tx)
        y = _shifted(d, e, f, xs[m], ys[m], zs[m], ty)
        squares[m] = x * x + y * y
        thetas[m] = turn_angle(x, y)
        heights[m] = _shifted(g, h, i, xs[m], ys[m], zs[m], tz)


@compiled(error_model="numpy", nogil=True)
def _find_near(
    place: Array,
    reach: Array,
    limits: GridLimits,
    ceiling: Array,
    tiles: Tiles,
    near: NDArray[np.bool_],
) -> None:
    """Which spheres may hold a point in contact (compiled)."""
    n_theta, n_z = ceiling.shape
    for b in range(reach.size):
        r, z = math.sqrt(place[0, b]), place[2, b]
        low = r - reach[b]
        near[b] = (
            z + reach[b] >= limits.z_min
            and z - reach[b] <= limits.z_max
            and low <= limits.r_outer
        )
        if near[b] and r >= tiles.floor:
            j = min(int(place[1, b] * tiles.per_theta), n_theta - 1)
            k = int(min(max((z - tiles.z_0) * tiles.per_z, 0.0), n_z - 1.0))
            near[b] = low <= ceiling[j, k]


@compiled(error_model="numpy", nogil=True)
def _find_nodes(
    size: int, nodes: IntArray, layout: RadiusLayout, place: Array, node: IntArray
) -> None:
    """The surface's cell under every point, without a branch (compiled)."""
    n_theta, n_z = nodes[0], nodes[1]
    thetas, heights, a, b = place[1], place[2], place[3], place[4]
    here, after = node[0], node[1]
    for m in range(size):
        here[m], after[m], a[m], b[m] = radius_cell(
            thetas[m], heights[m], n_theta, n_z, layout
        )


@compiled(error_model="numpy", nogil=True)
def _select(low: int, size: int, contact: int, s: FrameData) -> tuple[int, int, bool]:
    """Append the points inside the patient, r, θ, z in ``share`` (compiled).

    Args:
        low: First of the points that were placed.
        size: How many.
        contact: Points in contact so far.
        s: With the placed points.

    Returns:
        Points in contact so far, how many of the new ones lie beyond the inner layer,
        and whether any point lies within the grid.
    """
    place, node, radius, limits = s.place, s.node, s.radius, _extent(s.limits)
    touched, depth, share = s.touched, s.depth, s.share
    in_grid, beyond = False, 0
    for m in range(size):
        square, z = place[0, m], place[2, m]
        if not within(square, z, limits):
            continue
        in_grid = True
        r = math.sqrt(square)
        R = radius_between(node[0, m], node[1, m], place[3, m], place[4, m], radius)
        if R - r <= 0.0:
            continue
        touched[contact], depth[contact] = low + m, R - r
        share[0, contact], share[1, contact], share[2, contact] = r, place[1, m], z
        contact += 1
        if r < limits.r_inner:
            beyond += 1
    return contact, beyond, in_grid


@compiled(error_model="numpy", nogil=True)
def _find_spokes(contact: int, s: FrameData) -> None:
    """Places of every contact on the four spokes around it (compiled)."""
    depth, share, voxel, spokes = s.depth, s.share, s.voxel, s.spokes
    limits = _extent(s.limits)
    counts = (s.shape[1], s.shape[2])
    for c in range(contact):
        cell = spoke_cell(share[1, c], share[2, c], limits, counts[0], counts[1])
        steps = depth[c] * limits.per_r
        for corner in range(4):
            voxel[corner, c], share[corner, c], share[4 + corner, c] = corner_sample(
                corner, cell, steps, spokes, counts
            )


@compiled(error_model="numpy", nogil=True)
def _find_voxels(contact: int, s: FrameData) -> None:
    """Voxel of every contact and its part in the voxel's mean (compiled)."""
    depth, share, voxel, spokes = s.depth, s.share, s.voxel, s.spokes
    limits = _extent(s.limits)
    shape, hits = s.shape, s.hits
    for c in range(contact):
        v, samples = nearest_voxel(
            share[0, c], share[1, c], share[2, c], depth[c], limits, shape, spokes
        )
        voxel[0, c], share[0, c] = v, 1.0 if samples else 0.0
        hits[v] += 1 if samples else 0
    for c in range(contact):
        share[0, c] /= max(hits[voxel[0, c]], 1)
    for c in range(contact):  # leaves no trace in the next frame
        hits[voxel[0, c]] = 0


@compiled(error_model="numpy", nogil=True)
def _meets_grid(R: Array, at: Array, s: FrameData) -> bool:
    """Whether any shell point lies within the grid, skipped blocks too (compiled)."""
    start, spheres, points, limits = s.start, s.spheres, s.points, _extent(s.limits)
    for b in range(start.size - 1):
        x, y, z = rotated(R, spheres[0, b], spheres[1, b], spheres[2, b])
        x, y, z, reach = x + at[0], y + at[1], z + at[2], spheres[3, b]
        r = math.sqrt(x * x + y * y)
        if z + reach < limits.z_min or z - reach > limits.z_max:
            continue
        if r - reach > limits.r_outer:
            continue
        for m in range(start[b], start[b + 1]):
            x, y, z = rotated(R, points[0, m], points[1, m], points[2, m])
            x, y, z = x + at[0], y + at[1], z + at[2]
            if within(x * x + y * y, z, limits):
                return True
    return False


@compiled(error_model="numpy", nogil=True)
def wrench_of(
    values: Array, contact: int, R: Array, s: FrameData, wrench: Array
) -> None:
    """Sum a field's wrench over the points that `touch` found (compiled).

    Args:
        values: The field, flat, shape (V,) [N or N/cm²].
        contact: What `touch` returned.
        R: The same rotation as `touch` had.
        s: The same data.
        wrench: Out: force and torque, patient axes, shape (6,) [N, N·m].
    """
    voxel, share, touched, lever = s.voxel, s.share, s.touched, s.lever
    layer = s.shape[1] * s.shape[2]
    fx, fy, fz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for c in range(contact):
        if s.trilinear:
            p = 0.0
            for corner in range(4):
                v = voxel[corner, c]
                p += share[corner, c] * values[v]
                p += share[4 + corner, c] * values[v + layer]
        else:
            p = share[0, c] * values[voxel[0, c]]
        m = touched[c]
        fx += p * lever[m, 0]
        fy += p * lever[m, 1]
        fz += p * lever[m, 2]
        tx += p * lever[m, 3]
        ty += p * lever[m, 4]
        tz += p * lever[m, 5]
    wrench[0], wrench[1], wrench[2] = rotated(R, fx, fy, fz)
    wrench[3], wrench[4], wrench[5] = rotated(R, tx, ty, tz)
