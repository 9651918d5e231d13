"""From a scan to a surface: sections, contour filter, filling.

The steps: remove the supporting plane and limbs, cut the body into slices, collect the
points near the spokes (`ttus_opt.scan.candidates`), filter the contour over the angle
(`ttus_opt.scan.contour_filter`, eqs. 1-5), fill the unseen part (`ttus_opt.scan.fill`).

Arms beside a trunk are told by the gap that sections show between them. In each
section across the axis, what does not hang together with the rest, has less
than `SHARE` of its points and is no wider than an arm is a limb. Legs have half each,
and stay; so does a part of the trunk behind a fold, which is wide.
"""

from __future__ import annotations

import logging
from typing import Literal

import numpy as np

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.errors import GeometryError, InputError, warn
from ttus_opt.scan.candidates import collect, stray, usable_range
from ttus_opt.scan.contour_filter import (
    Contour,
    ContourModel,
    follow,
    without_end_cliffs,
)
from ttus_opt.scan.fill import fill_smoothly
from ttus_opt.scan.frame import Axis
from ttus_opt.scan.supporting_plane import SupportingPlane, check_shape
from ttus_opt.scan.surface import Surface

LOG = logging.getLogger(__name__)

_LARGEST_RADIUS = 0.5  # of a body [m]
_WIDEST = 0.30  # of a trunk, half its width; more is told [m]
_LEAST_POINTS = 100
_LEAST_OBSERVED = 0.05  # least fraction of observed nodes


def extract_surface(
    cloud: Array,
    *,
    axis: Axis,
    n_theta: int = 180,
    n_z: int = 60,
    z_range: tuple[float, float] | None = None,
    model: ContourModel | None = None,
    support: SupportingPlane | Literal["find"] | None = "find",
    point_std: Array | None = None,
) -> Surface:
    """Extract the surface r = R(θ, z) from a scan.

    Args:
        cloud: Scan, shape (n, 3) [m].
        axis: The patient frame in the scan, inside the body (`Axis.from_cloud`).
        n_theta: Number of spokes over the full turn.
        n_z: Number of slices.
        z_range: First and last height in the patient frame [m]; by default the
            longest range whose sections show the body's side (no cut ends).
        model: Depth noise and smoothness that the filter assumes, and how far from a
            spoke and a slice its candidates lie.
        support: The supporting plane, in the scan's frame, whose points are left out;
            "find" to take `Axis.support`, or to search for it if that is unknown;
            None when the scan has none.
        point_std: Standard deviation of every point, shape (n,) [m], as from a depth
            camera's noise model (`ttus_opt.sensors.depth`); by default the model's
            ``depth_noise``.

    Returns:
        The closed surface, with standard deviations and a mask of observed nodes.

    Raises:
        InputError: Invalid counts, deviations or cloud.
        GeometryError: The cloud never meets the axis or shows no body around it.
    """
    _check(cloud, n_theta, n_z, point_std)
    plane = axis.supporting_plane(cloud) if support == "find" else support
    points, std = _body_points(cloud, point_std, axis, plane)
    bed = "no table was found" if plane is None else "the table is left out"
    LOG.info("%d of %d points are the body's: %s", len(points), len(cloud), bed)
    z = _heights(points, z_range, n_z)
    theta: Array = np.arange(n_theta, dtype=np.float64) * (2.0 * np.pi / n_theta)
    contour = _contours(points, std, theta, z, model)
    _check_seen(contour)
    return filled_surface(contour, theta, z, axis, plane)


def followed(
    cloud: Array,
    axis: Axis,
    plane: SupportingPlane | None,
    theta: Array,
    z: Array,
    *,
    model: ContourModel | None = None,
    point_std: Array | None = None,
) -> Contour:
    """The contours of a scan on a given grid, also where it shows little of it.

    Args:
        cloud: Scan, shape (n, 3) [m].
        axis: The patient frame in the scan.
        plane: The supporting plane; None when there is none.
        theta: Angles from 0, equally spaced, shape (n_theta,) [rad].
        z: Heights, equally spaced, shape (n_z,) [m].
        model: Depth noise and smoothness that the filter assumes.
        point_std: Standard deviation of every point, shape (n,) [m].

    Raises:
        InputError: Invalid deviations or cloud.
        GeometryError: The cloud never meets the axis.
    """
    _check(cloud, len(theta), len(z), point_std)
    points, std = _body_points(cloud, point_std, axis, plane)
    return _contours(points, std, theta, z, model)


def _contours(
    points: Array,
    std: Array | None,
    theta: Array,
    z: Array,
    model: ContourModel | None,
) -> Contour:
    """Contours of body points (n, 3) [m], patient frame."""
    assumed = model or ContourModel()
    by_default = float(np.clip((z[1] - z[0]) / 2, 0.003, 0.006))
    candidates = collect(
        points,
        theta,
        z,
        spoke_distance=assumed.spoke_distance,
        slice_distance=assumed.slice_distance or by_default,
        std=std,
    )
    return without_end_cliffs(follow(candidates, assumed), float(z[1] - z[0]))


def filled_surface(
    contour: Contour,
    theta: Array,
    z: Array,
    axis: Axis,
    plane: SupportingPlane | None,
) -> Surface:
    """A surface from contours, with the unseen part filled smoothly."""
    radius, std = fill_smoothly(
        contour.radius,
        contour.variance,
        contour.observed,
        z_step=float(z[1] - z[0]),
        limit=None if plane is None else _plane_radius(plane, axis, theta, z),
    )
    _tell_wild(radius, contour, theta, z)
    return Surface(theta, z, radius, std, contour.observed, axis)


def _tell_wild(radius: Array, contour: Contour, theta: Array, z: Array) -> None:
    """Warn of radii that no trunk has: an arm, a wall, an axis beside the body."""
    wild = radius > _WIDEST
    if not wild.any():
        return
    j, k = np.unravel_index(int(radius.argmax()), radius.shape)
    seen = "was seen" if contour.observed[j, k] else "was filled, not seen"
    warn(
        f"R reaches {100 * radius[j, k]:.0f} cm, wider than a trunk, at "
        f"{np.degrees(theta[j]):.0f}° and z {100 * z[k]:.0f} cm, which {seen} "
        f"({100 * wild.mean():.0f} % of the nodes are beyond {100 * _WIDEST:.0f} cm): "
        "crop arms and what is around by a box or z_range, or give the axis",
        3,
    )


def _check(cloud: Array, n_theta: int, n_z: int, point_std: Array | None) -> None:
    for name, value, least in (("n_theta", n_theta, 8), ("n_z", n_z, 2)):
        if int(value) != value or value < least:
            raise InputError(f"{name} must be a whole number >= {least}, got {value}")
    check_shape(cloud)
    if len(cloud) < _LEAST_POINTS:
        raise InputError(
            f"a cloud of {len(cloud)} points is too small: give {_LEAST_POINTS} or more"
        )
    n_bad = int((~np.isfinite(cloud).all(axis=1)).sum())
    if n_bad:
        raise InputError(
            f"{n_bad} of {len(cloud)} points have NaN or infinite coordinates: leave "
            "them out (read_cloud(..., drop_nan=True))"
        )
    extent = float(np.ptp(cloud, axis=0).max())
    if extent > 10.0:
        raise InputError(
            f"largest coordinate extent is {extent:.4g} m: are these millimetres? read "
            "them with unit='mm'"
        )
    if point_std is None:
        return
    if point_std.shape != (len(cloud),):
        raise InputError(
            f"point_std must be one standard deviation [m] for each of {len(cloud)} "
            f"points, got shape {point_std.shape}"
        )
    if not (np.isfinite(point_std) & (point_std > 0)).all() or point_std.max() > 0.1:
        raise InputError(
            "point_std must be between 0 and 0.1 m: leave out other points, and give "
            "metres"
        )


def _body_points(
    cloud: Array, std: Array | None, axis: Axis, plane: SupportingPlane | None
) -> tuple[Array, Array | None]:
    """Points without support and outliers, patient frame, and their deviations [m]."""
    index = np.arange(len(cloud)) if plane is None else plane.above(cloud).nonzero()[0]
    points = axis.to_patient(cloud[index])
    near = np.hypot(points[:, 0], points[:, 1]) < _LARGEST_RADIUS
    points, index = points[near], index[near]
    if len(points) < _LEAST_POINTS:
        raise GeometryError(
            f"only {len(points)} of {len(cloud)} points are within "
            f"{_LARGEST_RADIUS:g} m of the axis and off the support: the cloud is "
            "nowhere near the axis, check axis and unit"
        )
    kept = ~stray(points)
    if plane is None:
        kept[kept] = trunk(points[kept])
    if kept.sum() < _LEAST_POINTS:
        raise GeometryError(
            f"only {int(kept.sum())} of {len(points)} points near the axis have others "
            "close by: the cloud is too sparse, record or export more of its points"
        )
    return points[kept], None if std is None else std[index[kept]]


def _heights(points: Array, z_range: tuple[float, float] | None, n_z: int) -> Array:
    """Heights of the slices, given or found, shape (n_z,) [m]."""
    if z_range is None:
        low, high = usable_range(points)
    else:
        low, high = z_range
        if not high > low:
            raise InputError(
                f"z_range must be (lowest, highest) [m], got ({low:g}, {high:g})"
            )
        inside = (points[:, 2] >= low) & (points[:, 2] <= high)
        if not inside.any():
            raise GeometryError(
                f"no point has a height between {low:g} and {high:g} m: the body spans "
                f"{points[:, 2].min():.3f} to {points[:, 2].max():.3f} m along the axis"
            )
    return np.linspace(low, high, n_z)


def _check_seen(contour: Contour) -> None:
    share = float(contour.observed.mean())
    widest = contour.observed.sum(axis=0).max() / len(contour.observed)
    if share < _LEAST_OBSERVED or widest < 0.2:
        raise GeometryError(
            f"points were found on {100 * share:.0f} % of the spokes only, at most "
            f"{360 * widest:.0f}° of a section: does the axis run inside the body?"
        )


def _plane_radius(plane: SupportingPlane, axis: Axis, theta: Array, z: Array) -> Array:
    """Radius at which each spoke meets the supporting plane, inf for none [m]."""
    normal = axis.rotation.T @ plane.normal
    offset = plane.offset - plane.normal @ axis.origin
    towards = normal[0] * np.cos(theta) + normal[1] * np.sin(theta)
    rest = offset - normal[2] * z
    with np.errstate(divide="ignore", invalid="ignore"):
        radius = rest[None, :] / towards[:, None]
    return np.where((towards[:, None] < -1e-6) & (radius > 0), radius, np.inf)


#: Height of a section, and the width of cells that must touch: at least, and in typical
#: distances between neighbouring points [m, m, –]
SECTION, CELL, NEIGHBOURS = 0.02, 0.012, 2.5

#: Largest share of a section's points in a limb [–]
SHARE = 0.3

#: Largest extent of a limb's section [m]
WIDTH = 0.16


def trunk(points: Array) -> Mask:
    """Which points (n, 3) [m], patient frame, belong to no limb, shape (n,)."""
    if len(points) < _LEAST_POINTS:
        return np.ones(len(points), bool)
    from scipy.ndimage import label
    from scipy.spatial import cKDTree

    some = points[:: max(1, len(points) // 2000)]
    distance = np.asarray(cKDTree(points).query(some, k=4)[0])
    cell = max(CELL, NEIGHBOURS * float(np.median(distance[:, -1])))
    at = (points - points.min(axis=0)) / [cell, cell, SECTION]
    place = tuple(at.astype(np.int64).T)
    filled = np.zeros([int(index.max()) + 1 for index in place], bool)
    filled[place] = True
    within = np.zeros((3, 3, 3), bool)
    within[:, :, 1] = True
    names, _ = label(filled, within)
    _, part = np.unique(names[place], return_inverse=True)
    of_part = np.bincount(part)
    of_section = np.bincount(place[2])
    low = np.full((len(of_part), 2), np.inf)
    high = -low
    np.minimum.at(low, part, points[:, :2])
    np.maximum.at(high, part, points[:, :2])
    wide = (high - low).max(axis=1) > WIDTH
    return np.asarray(wide[part] | (of_part[part] >= SHARE * of_section[place[2]]))
