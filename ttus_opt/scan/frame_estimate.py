"""The patient frame estimated from a scan: where a body's long inner axis runs.

With a supporting plane: x is the plane's normal (anterior, away from the support),
z lies in the plane along the body, and the origin is half-way between the support
and the ridge of the body, in the middle of its width: inside the body although only
its upper half was seen. Without one: z from the surface normals alone, the origin is
the centre of the circle that fits the cross-section best, x points to the side that
was seen or, on a body seen all around, along the shorter diameter.

z is the direction the body's sides run along: surface normals stand across it, so
the sum of (n·z)² is least. The squares are cut off, because the ends of a torso (a
shoulder, a cut) face along z and would otherwise outvote its sides; a second term
prefers the direction in which the body is long. The sign of an axis that is not
fixed otherwise is such that its largest component in the scan is positive.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.errors import GeometryError
from ttus_opt.scan.supporting_plane import SupportingPlane, find_supporting_plane

_CELL = 0.012  # edge of the cells that even out the density of points [m]
_CUT = 0.25  # (n·z)² beyond which a normal counts no more, 60° from the axis
#: Weight of the ratio of variances (longest/along) beside the mean cut (n·z)².
_LENGTH_WEIGHT = 0.05
_NEARBY = np.cos(np.radians(20.0))


class FrameEstimate(NamedTuple):
    """A patient frame and the supporting plane it was derived from.

    Attributes:
        origin: Origin of the patient frame in the scan, shape (3,) [m].
        rotation: Columns are the patient frame's axes in the scan, shape (3, 3) [–].
        support: The supporting plane, None when the scan shows none.
    """

    origin: Array
    rotation: Array
    support: SupportingPlane | None


def estimate_frame(
    cloud: Array, *, rng: np.random.Generator | None = None
) -> FrameEstimate:
    """Estimate the patient frame from a scan.

    Args:
        cloud: Scan, shape (n, 3) [m].
        rng: Draws the trial planes; a fixed seed when not given.

    Returns:
        The frame.

    Raises:
        InputError: The cloud is not (n, 3) or has fewer than 100 points.
        GeometryError: Nothing stands above the supporting plane, or the points do
            not span a body.
    """
    plane = find_supporting_plane(cloud, rng=rng)
    body = cloud if plane is None else cloud[plane.above(cloud)]
    points = _thinned(body)
    if len(points) < 50:
        raise GeometryError(
            f"only {len(body)} points stand above the supporting plane: the scan shows "
            "no body, or give the axis"
        )
    if plane is None:
        return _free_frame(points, _normals(points))
    return _supported_frame(points, _normals(points), plane)


def _thinned(points: Array) -> Array:
    """Means of the points in cubic cells: density no longer counts."""
    cell = np.floor((points - points.min(axis=0)) / _CELL).astype(np.int64)
    size = cell.max(axis=0) + 1
    key = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    _, place, count = np.unique(key, return_inverse=True, return_counts=True)
    sums = [np.bincount(place, weights=points[:, m]) for m in range(3)]
    lone = count < max(1, np.median(count) / 10)  # stray points
    return np.asarray((np.stack(sums, axis=1) / count[:, None])[~lone])


def _normals(points: Array) -> Array:
    """Unit normals (either sign) from the sixteen nearest points, shape (n, 3)."""
    from scipy.spatial import cKDTree

    k = min(16, len(points))
    _, index = cKDTree(points).query(points, k=k)
    near = points[index] - points[index].mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", near, near))
    return np.asarray(vectors[:, :, 0])


def _along(points: Array, normals: Array, candidates: Array) -> Array:
    """The candidate direction (m, 3) that fits as the body's long axis, (3,)."""
    facing = np.minimum((normals @ candidates.T) ** 2, _CUT).mean(axis=0)
    spread = (points @ candidates.T).var(axis=0)
    coarse = candidates[np.argmin(facing + _LENGTH_WEIGHT * spread.max() / spread)]
    # The outline decides which way the body lies, its sides how exactly.
    nearby = np.abs(candidates @ coarse) > _NEARBY
    return np.asarray(candidates[np.argmin(np.where(nearby, facing, np.inf))])


def _positive(direction: Array) -> Array:
    """The direction with its largest component positive."""
    return np.asarray(direction * np.sign(direction[np.argmax(np.abs(direction))]))


def _supported_frame(
    points: Array, normals: Array, plane: SupportingPlane
) -> FrameEstimate:
    x = plane.normal
    first = np.cross(x, np.eye(3)[np.argmin(np.abs(x))])
    first /= np.linalg.norm(first)
    angle = np.arange(0.0, np.pi, np.radians(1.0))
    circle = np.outer(np.cos(angle), first) + np.outer(
        np.sin(angle), np.cross(x, first)
    )
    z = _positive(_along(points, normals, circle))
    y = np.cross(z, x)
    middle = [np.percentile(points @ a, [2, 98]).mean() for a in (y, z)]
    ridge = np.percentile(plane.height(points), 98)
    origin = (plane.offset + 0.5 * ridge) * x + middle[0] * y + middle[1] * z
    return FrameEstimate(origin, np.stack([x, y, z], axis=1), plane)


def _free_frame(points: Array, normals: Array) -> FrameEstimate:
    z = _positive(_along(points, normals, _half_sphere(4000)))
    u = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    u /= np.linalg.norm(u)
    section = points @ np.stack([u, np.cross(z, u)], axis=1)
    # Algebraic circle fit: |q|² = 2 c·q + (R² − |c|²) in least squares.
    mean = section.mean(axis=0)
    q = section - mean
    design = np.column_stack([2 * q, np.ones(len(q))])
    solution, _, rank, _ = np.linalg.lstsq(design, (q**2).sum(axis=1), rcond=1e-6)
    radius = np.sqrt(max(solution[2] + solution[:2] @ solution[:2], 0.0))
    if rank < 3 or not 0.01 < radius < 1.0:
        raise GeometryError(
            "the scan's cross-section is not round (a plane?): show more of the body "
            "or give the axis"
        )
    centre, seen = solution[:2], -solution[:2]
    if np.linalg.norm(seen) < 0.15 * radius:  # seen all around
        _, vectors = np.linalg.eigh(np.cov(q.T))
        x = _positive(vectors[0, 0] * u + vectors[1, 0] * np.cross(z, u))
    else:
        x = seen[0] * u + seen[1] * np.cross(z, u)
        x /= np.linalg.norm(x)
    centre = centre + mean
    height = np.percentile(points @ z, [2, 98]).mean()
    origin = centre[0] * u + centre[1] * np.cross(z, u) + height * z
    return FrameEstimate(origin, np.stack([x, np.cross(z, x), z], axis=1), None)


def _half_sphere(n: int) -> Array:
    """Evenly spread directions over half a sphere (Fibonacci), shape (n, 3)."""
    index = np.arange(n) + 0.5
    z = 1.0 - index / n
    azimuth = np.pi * (1.0 + np.sqrt(5.0)) * index
    rho = np.sqrt(1.0 - z**2)
    return np.stack([rho * np.cos(azimuth), rho * np.sin(azimuth), z], axis=1)
