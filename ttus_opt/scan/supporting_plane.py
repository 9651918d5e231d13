"""The plane on which a body lies (table, bed, floor), found in its scan.

Planes through random triples of points (RANSAC). A support differs from a flat part of
the body in that everything else lies on one side of it, and that it is wide in both
directions and extends beyond the body's outline.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError

#: Points this close to the plane may belong to it [m]: tables in scans are uneven.
TOLERANCE = 0.010
#: Least width of a support in its narrower direction [m]; a torso (radius of curvature
#: below about 0.3 m) touches a plane over a narrower patch.
LEAST_WIDTH = 0.17
_LEAST_SHARE = 0.02  # of all points
_MOST_BELOW = 0.02  # of all points, further below than the tolerance
_LEAST_OUTSIDE = 0.25  # of the plane's points, beyond the body's outline
_OUTLINE_MARGIN = 0.015  # [m]
#: Least ratio of points within the tolerance to those just beyond: arms and legs at one
#: depth are no plane.
_LEAST_PEAK = 2.5
_N_SAMPLE, _N_TRIALS, _N_ROUNDS = 4000, 600, 3


@dataclass(frozen=True)
class SupportingPlane:
    """The plane n·x = offset, with the body where n·x > offset.

    Attributes:
        normal: Unit normal towards the body, shape (3,) [–].
        offset: Distance from the scan's origin along the normal [m].
        thickness: Points up to this height count as the plane [m].
    """

    normal: Array
    offset: float
    thickness: float

    def height(self, points: Array) -> Array:
        """Heights of scan points (n, 3) [m] above the plane, shape (n,) [m]."""
        return np.asarray(points @ self.normal - self.offset)

    def above(self, points: Array) -> NDArray[np.bool_]:
        """Which scan points (n, 3) [m] stand clear of the plane, shape (n,)."""
        return self.height(points) > self.thickness


def find_supporting_plane(
    cloud: Array,
    *,
    rng: np.random.Generator | None = None,
    camera: Array | None = None,
) -> SupportingPlane | None:
    """The plane on which the body lies, or None when the scan shows none.

    Args:
        cloud: Scan, shape (n, 3) [m].
        rng: Draws the trial planes; a fixed seed when not given, so that the same
            scan gives the same plane.
        camera: Where the scan was seen from, shape (3,) [m]: a body lies on the
            camera's side of its support.

    Raises:
        InputError: The cloud is not (n, 3) or has fewer than 100 points.
    """
    check_shape(cloud)
    if len(cloud) < 100:
        raise InputError(f"a cloud of {len(cloud)} points is too small: 100 at least")
    rng = rng or np.random.default_rng(0)
    sample = rng.permutation(cloud)[:_N_SAMPLE]
    for _ in range(_N_ROUNDS):  # one round may miss a bed of which little is seen
        best = _one_round(sample, rng, camera)
        if best is not None:
            return _finish(cloud, *best)
    return None


def check_shape(cloud: Array) -> None:
    """`InputError` for a cloud that is not (n, 3)."""
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise InputError(f"a cloud must be (n, 3) [m], got {cloud.shape}: transposed?")


def across(direction: Array) -> Array:
    """Two unit vectors orthogonal to a given one (3,) and each other, (2, 3)."""
    first = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])


def _one_round(
    sample: Array, rng: np.random.Generator, camera: Array | None
) -> tuple[Array, float] | None:
    """The best trial plane that is a support; None without one."""
    normals, offsets = _trial_planes(sample, rng)
    heights = normals @ sample.T - offsets[:, None]
    below = (heights < -TOLERANCE).mean(axis=1)
    near = (np.abs(heights) < TOLERANCE).mean(axis=1)
    score = np.where((below < 3 * _MOST_BELOW) & (near > _LEAST_SHARE), near, 0.0)
    # All are tried: a body's flank may hold more points than the visible bed.
    for best in np.argsort(-score):
        if score[best] == 0:
            return None
        normal, offset = refined_plane(sample, normals[best], float(offsets[best]))
        behind = camera is not None and normal @ camera <= offset
        if not behind and _supports(sample, normal, offset):
            return normal, offset
    return None


def _trial_planes(sample: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Planes through three points, each in both orientations.

    Three quarters of the triples are neighbours: three points from anywhere hardly ever
    lie on a bed of which little is seen.
    """
    from scipy.spatial import cKDTree

    n = 3 * _N_TRIALS // 4
    index = rng.integers(len(sample), size=(3, _N_TRIALS))
    _, found = cKDTree(sample).query(sample[index[0, :n]], k=min(100, len(sample)))
    near = np.asarray(found)
    index[1:, :n] = near[np.arange(n), rng.integers(near.shape[1], size=(2, n))]
    normals, offsets = planes_through(*sample[index])
    return np.concatenate([normals, -normals]), np.concatenate([offsets, -offsets])


def planes_through(a: Array, b: Array, c: Array) -> tuple[Array, Array]:
    """Unit normals (k, 3) and offsets (k,) of the planes through points (n, 3) [m]."""
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    good = length > 1e-4  # m²; three points in a row span nothing
    normals = normals[good] / length[good, None]
    return normals, np.einsum("ij,ij->i", normals, a[good])


def refined_plane(
    points: Array, normal: Array, offset: float, tolerance: float = TOLERANCE
) -> tuple[Array, float]:
    """Normal and offset [m] by least squares on the points near a plane, repeated.

    Args:
        points: Shape (n, 3) [m].
        normal: Unit normal of the plane, shape (3,).
        offset: Of the plane [m].
        tolerance: Points up to this far from the plane count [m].
    """
    last: NDArray[np.bool_] | None = None
    for _ in range(6):
        within = np.abs(points @ normal - offset) < tolerance
        if last is not None and np.array_equal(within, last):
            break  # nothing moves any more
        near, last = points[within], within
        if len(near) < 10:
            break
        centre = near.mean(axis=0)
        off = near - centre
        _, vectors = np.linalg.eigh(off.T @ off)
        refined = vectors[:, 0] * np.sign(vectors[:, 0] @ normal)
        if refined @ normal < 0.95:
            break
        normal, offset = refined, float(centre @ refined)
    return normal, offset


def _supports(sample: Array, normal: Array, offset: float) -> bool:
    """Whether the plane is one-sided, wide, and reaches beyond the body."""
    height = sample @ normal - offset
    near = sample[np.abs(height) < TOLERANCE]
    body = sample[height > 2 * TOLERANCE]
    if (height < -TOLERANCE).mean() > _MOST_BELOW or min(len(near), len(body)) < 30:
        return False
    beyond = int((np.abs(height) < 2 * TOLERANCE).sum()) - len(near)
    if len(near) < _LEAST_PEAK * beyond:
        return False
    angle = np.linspace(0, np.pi, 16, endpoint=False)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1) @ across(normal)
    seen = near @ along.T
    width = np.ptp(np.percentile(seen, [2, 98], axis=0), axis=0).min()
    if width < LEAST_WIDTH:
        return False
    low, high = np.percentile(body[::4] @ along.T, [0.5, 99.5], axis=0)
    outside = (seen < low - _OUTLINE_MARGIN) | (seen > high + _OUTLINE_MARGIN)
    return bool(outside.any(axis=1).mean() > _LEAST_OUTSIDE)


def _finish(cloud: Array, normal: Array, offset: float) -> SupportingPlane:
    """Refine on all points; the thickness follows from how flat the plane is."""
    normal, offset = refined_plane(cloud, normal, offset)
    height = cloud @ normal - offset
    spread = 1.48 * np.median(np.abs(height[np.abs(height) < 2 * TOLERANCE]))
    return SupportingPlane(normal, offset, float(max(TOLERANCE, 4.0 * spread)))
