"""Ranges of the deviations and lengths of a depth map on a grid.

With a length far below the grid's spacing, neighbouring voxels are independent whatever
the length; beyond the patient's size, the field is a constant factor on the profile.
"""

from __future__ import annotations

import numpy as np

from ttus_opt.core.errors import InputError
from ttus_opt.voxmap.grid import CylindricalGrid

#: Least and largest relative standard deviation: forces do not resolve 0.1 %, and at a
#: factor of 100 the profile has no influence [–]
DEVIATIONS = (1e-3, 100.0)

#: Least and largest ratio of the length around to the length along; beyond, the field
#: does not vary in one direction [–]
RATIOS = (1e-3, 1e3)

#: Least length over the grid's spacing, for which neighbours are correlated by 1 % [–]
LEAST_SPACINGS = 0.25


def depth_map_limits(grid: CylindricalGrid) -> dict[str, tuple[float, float]]:
    """Ranges by name, of σ [–], lengths [m] and length around over along [–].

    Lengths along the surface reach from a quarter of the innermost layer's spacing to
    the outermost's extent, those along the depth from a quarter of a layer to all.
    """
    least = LEAST_SPACINGS * min(grid.theta_step * grid.r_inner, grid.z_step)
    extent = max(2.0 * np.pi * grid.r_outer, grid.z_max - grid.z_min)
    return {
        "deviation": DEVIATIONS,
        "surface_length": (least, extent),
        "depth_length": (LEAST_SPACINGS * grid.r_step, grid.r_outer - grid.r_inner),
        "length_ratio": RATIOS,
    }


def check_depth_map(grid: CylindricalGrid, **given: float | None) -> None:
    """Validate given hyperparameters of a depth map.

    Args:
        grid: The voxels.
        given: By name, as in `depth_map_limits`; None where it is not given.

    Raises:
        InputError: One of them lies outside its range.
    """
    for name, (low, high) in depth_map_limits(grid).items():
        value = given.get(name)
        if value is not None and not low <= value <= high:
            where = " m on this grid" if name.endswith("_length") else ""
            raise InputError(
                f"{name} must lie between {low:.3g} and {high:.3g}{where}, got {value}"
            )
