"""Update of a surface by a later scan.

The later scan's contours are found on the earlier surface's grid and frame. At nodes
seen by both scans, radii that agree are averaged by their variances, otherwise the
later one replaces the earlier; at nodes seen by one, that radius is used; the unseen
part is filled anew. Radii agree when they differ by less than three standard deviations
of their difference.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError, warn
from ttus_opt.scan.contour_filter import Contour, ContourModel
from ttus_opt.scan.extraction import filled_surface, followed
from ttus_opt.scan.supporting_plane import SupportingPlane
from ttus_opt.scan.surface import Surface

#: Largest difference of radii that agree [standard deviations]
ALIKE = 3.0

#: A larger median difference [m], over more than this fraction of the nodes that the
#: earlier scan saw, means that the patient has moved
MOVED, MOVED_SHARE = 0.008, 0.25

#: Least standard deviation of a known radius [m]
LEAST_STD = 1e-4


@dataclass(frozen=True)
class Updated:
    """An updated surface, and fractions of its nodes.

    Attributes:
        surface: On the earlier one's grid and in its frame.
        kept: Nodes that only the earlier scan saw [–].
        averaged: Nodes where both scans agree [–].
        replaced: Nodes that both saw and that changed [–].
        added: Nodes that only the later scan saw [–].
        difference: Median of later - earlier where both saw a node [m]; NaN for none.
    """

    surface: Surface
    kept: float
    averaged: float
    replaced: float
    added: float
    difference: float


def update_surface(
    earlier: Surface,
    cloud: Array,
    *,
    point_std: Array | None = None,
    model: ContourModel | None = None,
    support: SupportingPlane | Literal["find"] | None = "find",
) -> Updated:
    """Update a surface by a later scan of the same patient, all of it or a part.

    Args:
        earlier: The surface.
        cloud: The later scan, in the frame of the earlier one, shape (n, 3) [m].
        point_std: Standard deviation of every point, shape (n,) [m].
        model: Depth noise and smoothness the filter assumes.
        support: As in `ttus_opt.extract_surface`.

    Returns:
        The updated surface. A `TtusWarning` says if the patient seems to have moved.

    Raises:
        InputError: An invalid cloud, or a surface whose angles do not begin at 0.
        GeometryError: The scan never meets the surface's axis.
    """
    if abs(earlier.theta[0]) > 1e-9:
        raise InputError(
            f"the surface's angles begin at {earlier.theta[0]:.4g} rad, expected 0: "
            "extract it anew"
        )
    axis = replace(earlier.axis, support="unknown")
    plane = axis.supporting_plane(cloud) if support == "find" else support
    later = followed(
        cloud, axis, plane, earlier.theta, earlier.z, model=model, point_std=point_std
    )
    both = earlier.observed & later.observed
    variance = np.maximum(earlier.radius_std, LEAST_STD) ** 2
    change = later.radius - earlier.radius
    total = variance + later.variance
    alike = both & (change**2 <= ALIKE**2 * total)
    gain = np.where(alike, variance / total, np.where(later.observed, 1.0, 0.0))
    seen = earlier.observed | later.observed
    merged = Contour(
        earlier.radius + gain * change,
        np.where(
            alike,
            variance * later.variance / total,
            np.where(later.observed, later.variance, variance),
        ),
        seen,
    )
    difference = float(np.median(change[both])) if both.any() else float("nan")
    if abs(difference) > MOVED and both.sum() > MOVED_SHARE * earlier.observed.sum():
        warn(
            f"the later scan lies {1e3 * difference:+.0f} mm off the earlier one in "
            "the median: has the patient moved? Extract the surface anew then"
        )
    return Updated(
        filled_surface(merged, earlier.theta, earlier.z, axis, plane),
        float((earlier.observed & ~later.observed).mean()),
        float(alike.mean()),
        float((both & ~alike).mean()),
        float((later.observed & ~earlier.observed).mean()),
        difference,
    )
