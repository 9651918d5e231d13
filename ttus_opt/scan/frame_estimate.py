"""The patient frame estimated from a scan: where a body's long inner axis runs.

x points to the patient's right, y to the front (anterior), z to the head: the axes RAS
of medical images. With a supporting plane y is its normal, away from the support, z
lies in the plane along the body, and the origin is half-way between the support and
the ridge of the body, in the middle of its width: inside the body although only its
upper half was seen. Without one, z comes from the surface normals alone, the origin is
the centre of the circle that fits the cross-section best, and y points to the camera
where the scan is one view (`camera_of`), otherwise to the side that was seen or, on a
body seen all around, along the shorter diameter.

z is the direction along the body's sides: surface normals are perpendicular to it, so
it minimises the sum of (n·z)². The squares are clipped, because the ends of a torso (a
shoulder, a cut) face along z and would outvote the sides; a second term prefers the
direction in which the body is long. `ttus_opt.scan.body_sides` finds which end is the
head and, without a support, which side is the front.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import GeometryError, InputError
from ttus_opt.probe.even_sampling import sphere_lattice
from ttus_opt.scan.body_sides import (
    checked_direction,
    front_along,
    head_along,
    sign_towards,
)
from ttus_opt.scan.supporting_plane import (
    SupportingPlane,
    across,
    find_supporting_plane,
)

#: Half the widest field of view of a depth camera [rad], and its least distance [m]
HALF_VIEW, LEAST_DISTANCE = np.radians(60.0), 0.2

#: Width of a bundle of rays [rad], and the depth within it that a slope explains [m]
BUNDLE, SLOPE = 0.01, 0.06

#: Share of bundles that may be deeper: outlines, flying pixels, grazing surfaces
DEEP_SHARE = 0.2


def camera_of(cloud: Array) -> Array | None:
    """The place from which a scan was seen, None if it is no single view.

    A depth camera's points are in its own frame, with the camera at the origin. Such a
    scan is told by its shape: it lies within the view of a camera, and each of its rays
    meets the scene once. A body scanned all around, or from a place other than the
    origin, has points of its front and of its back on one ray.

    Args:
        cloud: Scan, shape (n, 3) [m].

    Returns:
        The scan's origin, shape (3,) [m].
    """
    distance = np.linalg.norm(cloud, axis=1)
    if not len(cloud) or np.quantile(distance, 0.01) < LEAST_DISTANCE:
        return None
    rays = cloud / np.maximum(distance, 1e-9)[:, None]
    middle = rays.mean(axis=0)
    middle /= max(float(np.linalg.norm(middle)), 1e-9)
    if np.quantile(rays @ middle, 0.01) < np.cos(HALF_VIEW):
        return None
    cell = np.floor(rays / BUNDLE).astype(np.int64)
    _, bundle, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    near, far = np.full(len(count), np.inf), np.zeros(len(count))
    np.minimum.at(near, bundle, distance)
    np.maximum.at(far, bundle, distance)
    several = count > 1
    if several.sum() < 10:  # too sparse to tell
        return None
    deep = (far - near)[several] > SLOPE
    return np.zeros(3) if deep.mean() <= DEEP_SHARE else None


_CELL = 0.012  # edge of the cells that equalise the density of points [m]
_CUT = 0.25  # (n·z)² is clipped here, at 60° from the axis
#: Weight of the ratio of variances (longest/along) beside the mean cut (n·z)².
_LENGTH_WEIGHT = 0.05
#: Radii of a cross-section that a circle's fit is believed for [m], and where not, half
#: the body's depth: a share of its width, within limits [–, m]
_ROUND, _HALF_DEPTH, _HALF_DEPTHS = (0.06, 0.20), 0.3, (0.05, 0.14)
_NEARBY = np.cos(np.radians(20.0))
_STEPS = 50  # of the refinement, which settles in about five


def estimate_frame(
    cloud: Array,
    head: ArrayLike | None,
    flip: bool,
    prone: bool,
    camera: ArrayLike | None,
    support: bool,
    rng: np.random.Generator | None,
) -> tuple[Array, Array, SupportingPlane | None]:
    """What an `Axis` is made of, estimated from a scan; see `Axis.from_cloud`."""
    towards = None if head is None else checked_direction(np.asarray(head, float))
    place = None if camera is None else np.asarray(camera, dtype=np.float64)
    if place is not None and not (place.shape == (3,) and np.isfinite(place).all()):
        raise InputError(f"a camera's place must be finite x,y,z [m], got {place}")
    eye = camera_of(cloud) if place is None else place
    plane = None
    if support:
        plane = find_supporting_plane(cloud, rng=rng, camera=place)
    body = cloud if plane is None else cloud[plane.above(cloud)]
    points = _thinned(body)
    if len(points) < 50:
        raise GeometryError(
            f"only {len(body)} points stand above the supporting plane: the scan shows "
            "no body, or give the axis"
        )
    normals = _normals(points)
    if plane is None:
        frame = _free_frame(points, normals, eye, stated=place is not None)
    else:
        frame = _supported_frame(points, normals, plane)
    origin, upward, z = frame
    if towards is not None:
        z = z * sign_towards(z, towards)
    else:
        depth = body @ upward if plane is None else plane.height(body)
        z = z * head_along(body @ z, depth, supported=plane is not None)
    if flip:
        z = -z
    y = -upward if prone else upward
    return origin, np.stack([np.cross(y, z), y, z], axis=1), plane


def _thinned(points: Array) -> Array:
    """Means of the points in cubic cells, so that density does not matter."""
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


def _along(points: Array, normals: Array, candidates: Array, basis: Array) -> Array:
    """The direction that fits best as the body's long axis, shape (3,).

    Args:
        points: Shape (n, 3) [m].
        normals: Shape (n, 3) [–].
        candidates: Directions to try, shape (m, 3) [–].
        basis: Orthonormal rows that span the candidates, shape (2 or 3, 3) [–].
    """
    facing = np.minimum((normals @ candidates.T) ** 2, _CUT).mean(axis=0)
    spread = (points @ candidates.T).var(axis=0)
    coarse = candidates[np.argmin(facing + _LENGTH_WEIGHT * spread.max() / spread)]
    # The outline gives the coarse direction, the sides the exact one.
    nearby = np.abs(candidates @ coarse) > _NEARBY
    z = candidates[np.argmin(np.where(nearby, facing, np.inf))]
    # Refine by least squares over the unclipped normals until their set is constant, so
    # that the minimum does not depend on the candidates.
    within = np.zeros(len(normals), dtype=bool)
    for _ in range(_STEPS):
        before, within = within, (normals @ z) ** 2 < _CUT
        if (within == before).all():
            break
        flat = normals[within] @ basis.T
        _, vectors = np.linalg.eigh(flat.T @ flat)
        z = vectors[:, 0] @ basis
    return np.asarray(z)


def _supported_frame(
    points: Array, normals: Array, plane: SupportingPlane
) -> tuple[Array, Array, Array]:
    """Origin, direction away from the support, and z or its opposite, (3,) each."""
    up, basis = plane.normal, across(plane.normal)
    angle = np.arange(0.0, np.pi, np.radians(1.0))
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1) @ basis
    z = _along(points, normals, circle, basis)
    side = np.cross(up, z)
    middle = [np.percentile(points @ a, [2, 98]).mean() for a in (side, z)]
    ridge = np.percentile(plane.height(points), 98)
    origin = (plane.offset + 0.5 * ridge) * up + middle[0] * side + middle[1] * z
    return origin, up, z


def _free_frame(
    points: Array, normals: Array, camera: Array | None, *, stated: bool
) -> tuple[Array, Array, Array]:
    """The same without a support: from the surface alone, or towards a camera."""
    z = _along(points, normals, sphere_lattice(8000)[:4000], np.eye(3))
    basis = across(z)
    section = points @ basis.T
    # Algebraic circle fit: |q|² = 2 c·q + (R² − |c|²) in least squares.
    mean = section.mean(axis=0)
    q = section - mean
    design = np.column_stack([2 * q, np.ones(len(q))])
    solution, _, rank, _ = np.linalg.lstsq(design, (q**2).sum(axis=1), rcond=1e-6)
    radius = np.sqrt(max(solution[2] + solution[:2] @ solution[:2], 0.0))
    if rank < 3 or not 0.01 < radius < (1.0 if camera is None else np.inf):
        raise GeometryError(
            "the scan's cross-section is not round (a plane?): show more of the body "
            "or give the axis"
        )
    centre, seen = solution[:2], -solution[:2]
    height = np.percentile(points @ z, [2, 98]).mean()
    origin = (centre + mean) @ basis + height * z
    all_around = np.linalg.norm(seen) < 0.15 * radius  # no one camera sees that
    upward = None if camera is None else _towards(camera, points, z)
    if upward is not None and (stated or not all_around):
        curved = float(seen @ (basis @ upward))
        believed = _ROUND[0] < radius < _ROUND[1]
        if believed and curved > 0.0:
            return origin, upward, z
        if stated or not believed:
            return _behind(points, upward, z), upward, z
        # it curves away from the scan's origin: the camera was elsewhere
    if all_around:
        _, vectors = np.linalg.eigh(np.cov(q.T))
        upward = vectors[:, 0] @ basis
        upward = upward * front_along(points @ upward)
    else:
        upward = seen @ basis
        upward /= np.linalg.norm(upward)
    return origin, upward, z


def _towards(camera: Array, points: Array, z: Array) -> Array | None:
    """Direction across the body to the camera, (3,); None if it looked along it."""
    towards = camera - points.mean(axis=0)
    upward = towards - (towards @ z) * z
    length = float(np.linalg.norm(upward))
    if length < 0.3 * float(np.linalg.norm(towards)):
        return None
    return np.asarray(upward / length)


def _behind(points: Array, upward: Array, z: Array) -> Array:
    """A point inside a body of which a side too flat for a circle was seen, (3,)."""
    side = np.cross(upward, z)
    left, right = np.percentile(points @ side, [2, 98])
    half_depth = float(np.clip(_HALF_DEPTH * (right - left), *_HALF_DEPTHS))
    ridge = np.percentile(points @ upward, 90)
    height = np.percentile(points @ z, [2, 98]).mean()
    middle = 0.5 * (left + right)
    return np.asarray(middle * side + (ridge - half_depth) * upward + height * z)
