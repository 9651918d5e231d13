"""Ranges of the deviations and lengths of a depth map on a grid.

With a length far below the grid's spacing, neighbouring voxels are independent whatever
the length; beyond the patient's size, the field is a constant factor on the profile.
"""

from __future__ import annotations

import numpy as np

from ttus_opt.errors import InputError
from ttus_opt.voxmap.grid import CylindricalGrid

#: Least and largest relative standard deviation: forces do not resolve 0.1 %, and at a
#: factor of 100 the profile has no influence [–]
DEVIATIONS = (1e-3, 100.0)

#: Least and largest ratio of the length around to the length along; beyond, the field
#: does not vary in one direction [–]
RATIOS = (1e-3, 1e3)

#: Least length over the grid's spacing, for which neighbours are correlated by 1 % [–]
LEAST_SPACINGS = 0.25


def check_depth_map(
    grid: CylindricalGrid,
    *,
    deviation: float | None = None,
    surface_length: float | None = None,
    depth_length: float | None = None,
    length_ratio: float | None = None,
) -> None:
    """Validate given hyperparameters of a depth map.

    Args:
        grid: The voxels.
        deviation: σ [–].
        surface_length: Matérn length along the surface [m].
        depth_length: Matérn length along the depth [m].
        length_ratio: Length around over length along [–].

    Raises:
        InputError: One of them lies outside its range.
    """
    given = {
        "deviation": (deviation, DEVIATIONS),
        "surface_length": (surface_length, surface_lengths(grid)),
        "depth_length": (depth_length, depth_lengths(grid)),
        "length_ratio": (length_ratio, RATIOS),
    }
    for name, (value, (low, high)) in given.items():
        if value is not None and not low <= value <= high:
            where = " m on this grid" if name.endswith("_length") else ""
            raise InputError(
                f"{name} must lie between {low:.3g} and {high:.3g}{where}, got {value}"
            )


def surface_lengths(grid: CylindricalGrid) -> tuple[float, float]:
    """A quarter of the innermost layer's spacing, to the outermost's extent [m]."""
    least = LEAST_SPACINGS * min(grid.theta_step * grid.r_inner, grid.z_step)
    return least, max(2.0 * np.pi * grid.r_outer, grid.z_max - grid.z_min)


def depth_lengths(grid: CylindricalGrid) -> tuple[float, float]:
    """A quarter of a layer, to all of them [m]."""
    return LEAST_SPACINGS * grid.r_step, grid.r_outer - grid.r_inner
