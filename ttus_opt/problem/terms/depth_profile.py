"""Growth of a field with the depth below the surface, φ(d) = Σ_j c_j (d/d₀)^a_j.

The deviations and lengths of a depth map about it have ranges on a grid: with a length
far below the grid's spacing, neighbouring voxels are independent whatever the length;
beyond the patient's size, the field is a constant factor on the profile.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.voxmap.grid import CylindricalGrid
from ttus_opt.voxmap.voxmap import Voxmap

#: d₀, the depth at which the powers are 1 [m]
REFERENCE_DEPTH = 0.01

#: Powers of a stiff layer (1), a round tip on a half-space (1.5), stiffening tissue
#: (2, 3)
EXPONENTS = (1.0, 1.5, 2.0, 3.0)

#: Least depth of a derivative [m]
LEAST_SLOPED = 5e-4


@dataclass(frozen=True)
class DepthProfile:
    """A sum of powers with nonnegative coefficients, continued as an odd function.

    Attributes:
        exponents: a_j [–].
        coefficients: c_j [unit of p].
    """

    exponents: tuple[float, ...]
    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        """Validate exponents and coefficients: a sum of powers that is not zero."""
        powers, parts = self.exponents, self.coefficients
        if len(powers) != len(parts) or not powers:
            raise InputError(
                f"a depth profile takes one coefficient per exponent, got {len(parts)} "
                f"for {len(powers)}"
            )
        if not all(math.isfinite(a) and a > 0.0 for a in powers):
            raise InputError(f"depth exponents must be positive, got {powers}")
        if not all(math.isfinite(c) and c >= 0.0 for c in parts) or not any(parts):
            raise InputError(
                "depth coefficients must not be negative, and one positive, got "
                f"{parts}"
            )

    def __str__(self) -> str:
        parts = zip(self.coefficients, self.exponents, strict=True)
        return " + ".join(f"{c:.3g} (d/10 mm)^{a:.3g}" for c, a in parts if c)

    def __call__(self, depth: Array) -> Array:
        """φ at depths below the surface; −φ(|d|) above it.

        Args:
            depth: Any shape [m].

        Returns:
            The same shape [unit of p].
        """
        size = powers_of(np.abs(depth), self.exponents) @ np.array(self.coefficients)
        return np.asarray(np.copysign(size, depth))


def slopes_of(depth: Array, exponents: tuple[float, ...]) -> Array:
    """Derivatives of `powers_of` [1/m], of nonnegative depths.

    Below half a millimetre, where those of small powers have no bound, secants.
    """
    per_depth = np.array(exponents) / np.maximum(depth, LEAST_SLOPED)[..., None]
    return np.asarray(per_depth * powers_of(depth, exponents))


def powers_of(depth: Array, exponents: tuple[float, ...]) -> Array:
    """(d/d₀)^a for every depth and exponent, one more axis at the end."""
    return np.asarray((depth[..., None] / REFERENCE_DEPTH) ** np.array(exponents))


#: Power of the cosine between a spoke and the skin's normal, by which a depth along the
#: spoke counts. 1 is the depth along the normal, which a probe feels. Bodies are softer
#: where their skin falls away to a side: with 2 the evidence of all of 12 torsos that
#: were pressed at their sides too is larger, and of three of six pieces of tissue
SLOPED = 2


def voxel_depths(voxmap: Voxmap) -> Array:
    """Depth of every voxel below the surface, shape (V,) [m].

    That along its spoke times the square of the spoke's cosine (`SLOPED`).
    """
    along = voxmap.spoke_radius - voxmap.grid.r[:, None, None]
    return np.asarray((along * voxmap.spoke_cosine**SLOPED).ravel())


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
