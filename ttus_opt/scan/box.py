"""A box that crops a scan to the patient, so that a whole room may be read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError


def inside(cloud: Array, box: Sequence[float]) -> NDArray[np.bool_]:
    """Which points of a scan are inside a box.

    Args:
        cloud: Scan, shape (n, 3) [m].
        box: xmin, xmax, ymin, ymax, zmin, zmax, in the scan's frame [m]; infinite
            on an open side.

    Returns:
        A mask, shape (n,).

    Raises:
        InputError: Not six numbers, a lower limit that is not below the upper, or no
            point inside; the message gives the extent of the points.

    Examples:
        >>> inside(np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]), [-1, 1, -1, 1, -1, 1])
        array([ True, False])
    """
    limits = np.asarray(box, dtype=np.float64)
    if limits.shape != (6,) or np.isnan(limits).any():
        given = ",".join(map(str, box))
        raise InputError(f"a box is xmin,xmax,ymin,ymax,zmin,zmax [m], got {given}")
    low, high = limits[::2], limits[1::2]
    for axis, a, b in zip("xyz", low, high, strict=True):
        if not a < b:
            raise InputError(
                f"the box has {axis}min {a:g} and {axis}max {b:g}: the minimum must "
                "be smaller"
            )
    within = ((cloud >= low) & (cloud <= high)).all(axis=1)
    if not within.any():
        raise InputError(
            f"no point lies in the box: the scan reaches {extent_words(cloud)} m: give "
            "the box in metres, in the scan's frame"
        )
    return np.asarray(within)


def extent_words(cloud: Array) -> str:
    """The extent of points (n, 3) along each axis, as text."""
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    return ", ".join(
        f"{axis} {a:.3g} to {b:.3g}"
        for axis, a, b in zip("xyz", low.tolist(), high.tolist(), strict=True)
    )
