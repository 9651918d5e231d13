"""The compiled haptic frame: contact points of a pose, then the wrench of a field.

There are two passes over preallocated arrays, so a second field costs only the second:

- `touch` finds the shell points inside the patient. Blocks away from the surface are
  skipped by their bounding spheres (`ttus_opt.contact.shell_blocks`); the others go
  through branch-free loops, which the compiler vectorises.
- `wrench_of` samples one field at those points and sums its wrench. The functions that
  sample are those of the fit's rows (`ttus_opt.voxmap.sampling`), so that both
  use the same voxels and weights.

Arithmetic is float64 without fast-math: with reordered or fused operations a point near
a voxel face could be on different sides of it in the fit and in the frame.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ttus_opt.contact.contact_size import REFERENCE_LENGTH
from ttus_opt.contact.rows import beside, rotated, within
from ttus_opt.contact.shell_blocks import Tiles
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.compiled import compiled
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.probe.cylindrical import TURN, turn_angle
from ttus_opt.scan.radius_lookup import RadiusLayout, radius_between, radius_cell
from ttus_opt.voxmap.grid import GridLimits, around, depth_at
from ttus_opt.voxmap.sampling import corner_sample, nearest_voxel, spoke_cell

#: Index of ℓ₀ in `FrameData.limits`
LENGTH = 11


@compiled(error_model="numpy", nogil=True)
def touch(R: Array, at: Array, s: FrameData) -> tuple[int, bool, int]:
    """Find the points in contact and where they sample (compiled).

    Args:
        R: Rotation, probe to patient, shape (3, 3) [–].
        at: Position, shape (3,) [m].
        s: Probe, surface and scratch; its ``touched``, ``depth``, ``spot``, ``voxel``
            and ``share`` are written.

    Returns:
        Number of points in contact, whether any shell point is in the grid, and how
        many of the points in contact lie beyond the inner layer.
    """
    # read once: every access to the tuple counts references
    start, points, place, node = s.start, s.points, s.place, s.node
    n_blocks, room = start.size - 1, place.shape[1]
    near, limits = s.near, _extent(s.limits)
    a, b = s.layout, s.tiles
    layout, tiles = RadiusLayout(a[0], a[1], a[2], a[3]), Tiles(b[0], b[1], b[2], b[3])
    _place(R, at, s.spheres, 0, n_blocks, place)
    _find_near(place, s.spheres[3], limits, s.ceiling, tiles, near)
    contact, beyond, met, first = 0, 0, 0, 0
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
        met += _find_depths(high - low, place, node, s.radius, limits)
        if limits.width < TURN:
            met -= _leave_out(high - low, place, limits)
        contact, deeper = _keep(low, high - low, contact, s)
        beyond += deeper
    if not s.trilinear:
        _find_voxels(contact, s)
    elif s.limits[LENGTH] > 0.0:
        s.share[0] = _size_factor(contact, s)
    return contact, met > 0 or _meets_grid(R, at, s), beyond


@compiled(inline="always")
def _extent(a: Array) -> GridLimits:
    """A grid's limits by name (compiled)."""
    return GridLimits(a[0], a[1], a[2], a[3], a[4], a[5], a[6], a[7], a[8], a[9], a[10])


@compiled(inline="always")
def _shifted(
    a: float, b: float, c: float, x: float, y: float, z: float, shift: float
) -> float:
    """One coordinate of R x + t, rounded as `contact.rows` rounds it (compiled)."""
    return (a * x + b * y + c * z) + shift


@compiled(error_model="numpy", nogil=True)
def _place(
    R: Array, at: Array, points: Array, low: int, high: int, place: Array
) -> None:
    """Coordinates r², θ, z of points low to high, branch-free (compiled)."""
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
    """Which bounding spheres may contain a point in contact (compiled)."""
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
    """The surface cell below every point, branch-free (compiled)."""
    n_theta, n_z = nodes[0], nodes[1]
    thetas, heights, a, b = place[1], place[2], place[3], place[4]
    here, after = node[0], node[1]
    for m in range(size):
        here[m], after[m], a[m], b[m] = radius_cell(
            thetas[m], heights[m], n_theta, n_z, layout
        )


@compiled(error_model="numpy", nogil=True, apart=True)
def _find_depths(
    size: int, place: Array, node: IntArray, radius: Array, limits: GridLimits
) -> int:
    """Radius and depth of every placed point, branch-free (compiled).

    Args:
        size: Number of points.
        place: Written: r and depth; the depth is −1 outside the grid.
        node: Their surface cells, as indices of nodes.
        radius: Radius of those nodes, flat [m].
        limits: Limits of the grid.

    Returns:
        Number of points within the grid.
    """
    squares, heights, a, b = place[0], place[2], place[3], place[4]
    here, after, radii, depths = node[0], node[1], place[5], place[6]
    met = 0
    for m in range(size):
        r = math.sqrt(squares[m])
        skin = radius_between(here[m], after[m], a[m], b[m], radius)
        depth = depth_at(skin, r, heights[m], limits)
        is_met = within(squares[m], heights[m], limits)
        radii[m], depths[m] = r, depth if is_met else -1.0
        met += 1 if is_met else 0
    return met


@compiled(error_model="numpy", nogil=True)
def _leave_out(size: int, place: Array, limits: GridLimits) -> int:
    """Set the depth of points outside the grid's sector to −1 (compiled).

    Returns:
        How many of them are within the grid's other limits.
    """
    squares, thetas, heights, depths = place[0], place[1], place[2], place[6]
    met = 0
    for m in range(size):
        if around(thetas[m], limits) > limits.width:
            met += 1 if within(squares[m], heights[m], limits) else 0
            depths[m] = -1.0
    return met


@compiled(error_model="numpy", nogil=True)
def _keep(low: int, size: int, contact: int, s: FrameData) -> tuple[int, int]:
    """Append the points inside the patient, branch-free (compiled).

    Args:
        low: Index of the first placed point.
        size: Number of placed points.
        contact: Number of points in contact so far.
        s: With the placed points and their depths.

    Returns:
        Number of points in contact so far, and how many of the new ones lie beyond the
        inner layer.
    """
    place, touched, depth, spot = s.place, s.touched, s.depth, s.spot
    inner, beyond = s.limits[0], 0
    for m in range(size):  # a point outside is written too, then overwritten
        r, d = place[5, m], place[6, m]
        touched[contact], depth[contact] = low + m, d
        spot[0, contact], spot[1, contact], spot[2, contact] = (
            r,
            place[1, m],
            place[2, m],
        )
        is_kept = 1 if d > 0.0 else 0
        contact += is_kept
        beyond += is_kept if r < inner else 0
    return contact, beyond


@compiled(error_model="numpy", nogil=True)
def near_end(contact: int, s: FrameData) -> bool:
    """Whether a point in contact lies in a voxel where forces fade (compiled)."""
    heights, limits, found = s.spot[2], _extent(s.limits), 0
    for c in range(contact):
        voxels = min(heights[c] - limits.z_min, limits.z_max - heights[c])
        found += 1 if voxels * limits.per_z < 1.0 else 0
    return found > 0


@compiled(error_model="numpy", nogil=True)
def _size_factor(contact: int, s: FrameData) -> float:
    """10 mm/ℓ of the points in contact, as in `contact.contact_size` (compiled)."""
    touched, depth, points, lever = s.touched, s.depth, s.points, s.lever
    total, x, y, z, square = 0.0, 0.0, 0.0, 0.0, 0.0
    for c in range(contact):
        m = touched[c]
        a, b, d = points[0, m], points[1, m], points[2, m]
        n = lever[m, 0] ** 2 + lever[m, 1] ** 2 + lever[m, 2] ** 2
        w = depth[c] * math.sqrt(n)  # the lever's normal has the area as its length
        total += w
        x += w * a
        y += w * b
        z += w * d
        square += w * (a * a + b * b + d * d)
    if total > 0.0:
        x, y, z, square = x / total, y / total, z / total, square / total
    spread = max(square - (x * x + y * y + z * z), 0.0)
    return REFERENCE_LENGTH / math.sqrt(s.limits[LENGTH] ** 2 + 12.0 * spread)


@compiled(error_model="numpy", nogil=True)
def _find_voxels(contact: int, s: FrameData) -> None:
    """Voxel of every contact and its weight in the voxel's mean (compiled)."""
    depth, spot, share, voxel, spokes = s.depth, s.spot, s.share, s.voxel, s.spokes
    limits = _extent(s.limits)
    shape, hits = s.shape, s.hits
    for c in range(contact):
        v, samples = nearest_voxel(
            spot[0, c], spot[1, c], spot[2, c], depth[c], limits, shape, spokes
        )
        voxel[c], share[c] = v, 1.0 if samples else 0.0
        hits[v] += 1 if samples else 0
    for c in range(contact):
        share[c] /= max(hits[voxel[c]], 1)
    for c in range(contact):  # reset for the next frame
        hits[voxel[c]] = 0


@compiled(error_model="numpy", nogil=True)
def _meets_grid(R: Array, at: Array, s: FrameData) -> bool:
    """Whether any shell point, also in skipped blocks, is in the grid (compiled)."""
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
            if within(x * x + y * y, z, limits) and not beside(x, y, limits):
                return True
    return False


@compiled(error_model="numpy", nogil=True, apart=True)
def _sample(
    spot: Array,
    depths: Array,
    limits: GridLimits,
    counts: tuple[int, int],
    spokes: Array,
    values: Array,
    sampled: Array,
) -> None:
    """Sample a field on the four spokes around each point (compiled).

    Args:
        spot: r, θ, z of the points, shape (3, M) [m, rad, m].
        depths: Depths below the surface, shape (M,) [m].
        limits: Limits of the grid.
        counts: Number of voxels in θ and z [–].
        spokes: `sampling.spoke_table`.
        values: The field, flat, shape (V,) [N/cm²].
        sampled: Out: samples at the first n points, shape (n,) [N/cm²].
    """
    thetas, heights, layer = spot[1], spot[2], counts[0] * counts[1]
    for c in range(sampled.size):
        cell = spoke_cell(thetas[c], heights[c], limits, counts[0], counts[1])
        steps, p = depths[c] * limits.per_r, 0.0
        for corner in range(4):
            v, low, high = corner_sample(corner, cell, steps, spokes, counts)
            p += low * values[v]
            p += high * values[v + layer]
        sampled[c] = p


@compiled(error_model="numpy", nogil=True)
def wrench_of(
    values: Array, contact: int, R: Array, s: FrameData, wrench: Array
) -> None:
    """Sum a field's wrench over the points that `touch` found (compiled).

    Args:
        values: The field, flat, shape (V,) [N or N/cm²].
        contact: What `touch` returned.
        R: The rotation given to `touch`.
        s: The data given to `touch`.
        wrench: Out: force and torque, patient axes, shape (6,) [N, N·m].
    """
    touched, lever, sampled = s.touched, s.lever, s.sampled
    if s.trilinear:
        counts, limits = (s.shape[1], s.shape[2]), _extent(s.limits)
        _sample(s.spot, s.depth, limits, counts, s.spokes, values, sampled[:contact])
    else:
        for c in range(contact):
            sampled[c] = s.share[c] * values[s.voxel[c]]
    fx, fy, fz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for c in range(contact):
        p, m = sampled[c], touched[c]
        fx += p * lever[m, 0]
        fy += p * lever[m, 1]
        fz += p * lever[m, 2]
        tx += p * lever[m, 3]
        ty += p * lever[m, 4]
        tz += p * lever[m, 5]
    if s.limits[LENGTH] > 0.0:
        k = s.share[0]
        fx, fy, fz, tx, ty, tz = k * fx, k * fy, k * fz, k * tx, k * ty, k * tz
    wrench[0], wrench[1], wrench[2] = rotated(R, fx, fy, fz)
    wrench[3], wrench[4], wrench[5] = rotated(R, tx, ty, tz)
