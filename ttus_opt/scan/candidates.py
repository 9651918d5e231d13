"""Candidate radii of every spoke of a scan, and the usable range of heights.

A spoke is the half-line from the axis at angle θ in the slice at height z. Its
candidates (paper, before eq. 1) are the radii of the points within a threshold
distance of it. Everything is in the patient frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import GeometryError
from ttus_opt.probe.cylindrical import cylindrical

#: Points closer to the axis than this are inside any torso: outliers [m].
LEAST_RADIUS = 0.01
_STRAY_CELL = 0.01  # [m]
_BINS = (0.005, 0.01, 0.02, 0.04)  # thickness of a section, thin ones first [m]
_SECTORS = 36
_LEAST_SEEN = 9  # fewest sectors (90°) of a usable section
_STEEP = 0.010  # deviation of r in a sector that only occurs at a body's ends [m]
_STEEP_SHARE = 0.25
_ENOUGH = 0.1  # a range that needs no line over the angle [m]
_LONGER = 1.5  # a range by thicker sections that is so much longer is taken [–]
_LEAST_LENGTH = 0.015  # of a usable range [m]
_BRIDGE = 0.03  # most empty height within the body [m]


@dataclass(frozen=True)
class Candidates:
    """Radii near every spoke.

    Attributes:
        radius: Sorted along the last axis, padded with inf,
            shape (n_theta, n_z, n_most) [m].
        count: Number of points near the spoke before thinning, shape (n_theta, n_z).
        std: Standard deviations of the radii, same shape, 1 where padded [m]; None
            if the points have none.
        offset: Distance of the points from spoke and slice, as an angle about the
            axis, same shape as the radii, 0 where padded [rad]; None like ``std``.
    """

    radius: Array
    count: NDArray[np.int64]
    std: Array | None = None
    offset: Array | None = None


def stray(points: Array) -> NDArray[np.bool_]:
    """Mask of outliers among points (n, 3) [m]: flying pixels, remains of the bed.

    An outlier has fewer than four points, or than a tenth of the median number, in the
    cube of 3³ cells around it: a surface fills at least a whole layer of that cube.
    """
    cell = ((points - points.min(axis=0)) / _STRAY_CELL).astype(np.int64) + 1
    shape = cell.max(axis=0) + 2
    grid = np.zeros(shape, dtype=np.float32)
    place = tuple(cell.T)
    np.add.at(grid, place, 1.0)
    for dim in range(3):  # sums over three neighbours in each direction
        grid = grid + np.roll(grid, 1, axis=dim) + np.roll(grid, -1, axis=dim)
    around = grid[place]
    return np.asarray(around < max(4.0, 0.1 * float(np.median(around))))


def usable_range(points: Array) -> tuple[float, float]:
    """The longest range of heights whose sections show the body's side.

    A section is left out when it shows less than a quarter turn, or when the radii in a
    quarter of its sectors scatter as much as at an end of the body (a cut). Sections
    are thin; where those hold too few points to show it, as in one view from afar,
    thicker ones find a range that is clearly longer.

    Args:
        points: Body points, patient frame, shape (n, 3) [m].

    Returns:
        Lowest and highest usable height [m].

    Raises:
        GeometryError: No section shows a quarter turn around the axis, or too few.
    """
    best: tuple[float, float] | None = None
    length = 0.0
    for size in _BINS:
        found = _usable(points, size)
        if found and (best is None or found[1] - found[0] > _LONGER * length):
            best, length = found, found[1] - found[0]
    if best is None:
        raise GeometryError(
            "no section of the scan shows a quarter turn around the axis: does the "
            "axis run inside the body and along it? give another axis or estimate it, "
            "or give z_range=low,high"
        )
    if length < _LEAST_LENGTH:
        raise GeometryError(
            f"only {1e3 * length:.0f} mm of the scan show the body's side: show "
            "more of it, or give z_range=low,high"
        )
    return best


def _usable(points: Array, size: float) -> tuple[float, float] | None:
    """The same with sections of one thickness [m]; None where none is usable."""
    r, theta, z = cylindrical(points)
    start = z.min()
    level = ((z - start) / size).astype(np.int64)
    sector = (theta * (_SECTORS / (2 * np.pi))).astype(np.int64) % _SECTORS
    n = int(level.max()) + 1
    cell = level * _SECTORS + sector

    def total(weights: Array | None) -> Array:
        sums = np.bincount(cell, weights, n * _SECTORS).astype(np.float64)
        return sums.reshape(n, _SECTORS)

    count = total(None)
    enough = count >= 3
    per = 1.0 / np.maximum(count, 1)
    mean = total(r) * per
    variance = total(r**2) * per - mean**2
    angle = theta * (_SECTORS / (2 * np.pi)) % 1.0
    common = total(r * angle) * per - mean * total(angle) * per
    spread = total(angle**2) * per - (total(angle) * per) ** 2
    sloped = variance - common**2 / np.maximum(spread, 1e-6)
    n_seen = enough.sum(axis=1)
    runs: list[tuple[int, int]] = []
    # about the mean; where that leaves little, about a line over the angle, because the
    # edges of a flat front slope
    for scatter in (variance, sloped):
        steep = (enough & (scatter > _STEEP**2)).sum(axis=1)
        usable = (n_seen >= _LEAST_SEEN) & (steep <= _STEEP_SHARE * n_seen)
        empty = count.sum(axis=1) == 0
        runs = _runs(usable, empty, most=round(_BRIDGE / size))
        if any((last - first) * size >= _ENOUGH for first, last in runs):
            break
    if not runs:
        return None
    first, last = max(runs, key=lambda run: run[1] - run[0])
    # The outermost bins are only partly filled.
    return float(start + (first + 1) * size), float(start + last * size)


def _runs(
    usable: NDArray[np.bool_], empty: NDArray[np.bool_], most: int
) -> list[tuple[int, int]]:
    """First and last index of each run of usable bins, across ``most`` empty ones."""
    runs: list[tuple[int, int]] = []
    for k in np.flatnonzero(usable).tolist():
        gap = slice(runs[-1][1] + 1, k) if runs else slice(0)
        if runs and k - runs[-1][1] <= most and empty[gap].all():
            runs[-1] = (runs[-1][0], k)
        else:
            runs.append((k, k))
    return runs


def collect(
    points: Array,
    theta: Array,
    z: Array,
    *,
    spoke_distance: float,
    slice_distance: float,
    std: Array | None = None,
    n_most: int = 48,
) -> Candidates:
    """Candidates of every spoke.

    Args:
        points: Body points, patient frame, shape (n, 3) [m].
        theta: Angles of the spokes, equally spaced, shape (n_theta,) [rad].
        z: Heights of the slices, equally spaced, shape (n_z,) [m].
        spoke_distance: Largest distance from the spoke within the slice [m].
        slice_distance: Largest distance from the slice [m].
        std: Standard deviations of the points, shape (n,) [m].
        n_most: Most candidates of a spoke; more are thinned evenly.

    Raises:
        GeometryError: No point is near any spoke.
    """
    r, angle, height = cylindrical(points)
    keep = r > max(LEAST_RADIUS, spoke_distance)
    r, angle, height = r[keep], angle[keep], height[keep]
    node, point = _pairs(r, angle, height, theta, z, spoke_distance, slice_distance)
    shape = (len(theta), len(z))
    if len(node) == 0:
        raise GeometryError(
            f"no point of the scan lies near the axis between z = {z[0]:.3f} and "
            f"{z[-1]:.3f} m: the cloud is nowhere near the axis, check axis and unit"
        )
    order = np.lexsort((r[point], node))
    node, point = node[order], point[order]
    count = np.bincount(node, minlength=shape[0] * shape[1])
    rank = np.arange(len(node)) - (np.cumsum(count) - count)[node]
    # Thinning keeps the first candidate of each of the n_most equal parts.
    kept = np.minimum(count[node], n_most)
    place = rank * kept // count[node]
    first = (rank == 0) | (place != (rank - 1) * kept // count[node])
    node, point, place = node[first], point[first], place[first]

    def table(values: Array, padding: float) -> Array:
        out = np.full((count.size, min(n_most, int(count.max()))), padding)
        out[node, place] = values
        return out.reshape(*shape, -1)

    radii, counts = table(r[point], np.inf), count.reshape(shape)
    if std is None:
        return Candidates(radii, counts)
    across = np.sin(angle[point] - theta[node // len(z)])
    along = (height[point] - z[node % len(z)]) / r[point]
    offset = table(np.hypot(across, along), 0.0)
    return Candidates(radii, counts, table(std[keep][point], 1.0), offset)


def _pairs(
    r: Array,
    angle: Array,
    height: Array,
    theta: Array,
    z: Array,
    spoke_distance: float,
    slice_distance: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Node and index of every (spoke, point) within reach, shape (k,) each."""
    n_theta, n_z = len(theta), len(z)
    step, dz = 2 * np.pi / n_theta, z[1] - z[0]
    j = np.rint(angle / step).astype(np.int64)
    k = np.rint((height - z[0]) / dz).astype(np.int64)
    reach = spoke_distance / r  # sine of the largest angle from the spoke
    widest = np.arcsin(min(reach.max(initial=0.0), 1.0))
    most_j = min(int(widest / step + 0.5), (n_theta - 1) // 2)
    most_k = int(slice_distance / dz + 0.5)
    nodes, points = [], []
    for dj in range(-most_j, most_j + 1):
        near = np.abs(np.sin(angle - (j + dj) * step)) <= reach
        for dk in range(-most_k, most_k + 1):
            here = near & (k + dk >= 0) & (k + dk < n_z)
            here &= np.abs(height - (z[0] + (k + dk) * dz)) <= slice_distance
            nodes.append((((j + dj) % n_theta) * n_z + k + dk)[here])
            points.append(np.flatnonzero(here))
    return np.concatenate(nodes), np.concatenate(points)
