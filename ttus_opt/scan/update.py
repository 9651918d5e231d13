"""A later scan updates a surface: what is still valid stays.

The later scan is followed on the earlier surface's own grid and frame. Node by node:
seen by both and alike, the two are averaged by their variances; seen by both and
different, the later one holds; seen once, that one holds; never seen, the surface is
filled anew from all that was seen. Radii are alike when they differ by less than
three standard deviations of their difference.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.errors import InputError, TtusWarning
from ttus_opt.scan.contour_filter import Contour, ContourModel
from ttus_opt.scan.extraction import filled_surface, followed
from ttus_opt.scan.supporting_plane import SupportingPlane
from ttus_opt.scan.surface import Surface

#: Radii this many deviations apart are of a patient who changed
ALIKE = 3.0

#: A median difference beyond this [m], over more than this share of what the earlier
#: scan saw, is of a patient who lies elsewhere
MOVED, MOVED_SHARE = 0.008, 0.25

#: Least deviation of a known radius [m]
LEAST_STD = 1e-4


@dataclass(frozen=True)
class Updated:
    """An updated surface, and how it came about.

    Attributes:
        surface: The surface, on the earlier one's grid and in its frame.
        kept: Share of the nodes that only the earlier scan saw [–].
        averaged: Share that both saw alike [–].
        replaced: Share that both saw and that changed [–].
        added: Share that only the later scan saw [–].
        difference: Median of later - earlier where both saw it [m]; NaN where nowhere.
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
        support: As of `ttus_opt.extract_surface`.

    Returns:
        The updated surface. A `TtusWarning` says when the patient seems to have moved.

    Raises:
        InputError: A cloud that cannot be used, or a surface whose angles do not begin
            at 0.
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
        warnings.warn(
            f"the later scan lies {1e3 * difference:+.0f} mm off the earlier one in "
            "the median: has the patient moved? Extract the surface anew then",
            TtusWarning,
            stacklevel=2,
        )
    return Updated(
        filled_surface(merged, earlier.theta, earlier.z, axis, plane),
        float((earlier.observed & ~later.observed).mean()),
        float(alike.mean()),
        float((both & ~alike).mean()),
        float((later.observed & ~earlier.observed).mean()),
        difference,
    )
