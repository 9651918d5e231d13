"""The skin's radius at a place, in two steps that compiled loops can keep apart.

The same numbers as `ttus_opt.scan.surface.bilinear_radius`, bit for bit. Finding the
cell is arithmetic only and becomes vector instructions; looking up its corners is what
is left. The rows of the fit and the haptic frame both decide with it what is inside.
"""

from __future__ import annotations

import math

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.compiled import compiled
from ttus_opt.scan.surface import Surface


def skin_layout(surface: Surface) -> Array:
    """`Surface.kernel_layout` with its first angle in [0, 2π), as `skin_cell` needs."""
    layout = surface.kernel_layout
    layout[0] %= 2.0 * math.pi
    return layout


@compiled(inline="always")
def skin_cell(
    theta: float, z: float, n_theta: int, n_z: int, layout: Array
) -> tuple[int, int, float, float]:
    """Where `surface.bilinear_radius` looks, without branch or division (compiled).

    Args:
        theta: Angle in [0, 2π) [rad].
        z: Height [m].
        n_theta: Angles of the surface [–].
        n_z: Slices of the surface [–].
        layout: `skin_layout`.

    Returns:
        Flat index of the node before and of the next angle's, then the local (θ, z).
    """
    u = (theta - layout[0]) * layout[1]
    floor_u = np.floor(u)  # math.floor makes an integer and no vector instruction
    j = int(floor_u)
    j = j + n_theta if j < 0 else j
    j = j - n_theta if j >= n_theta else j
    j_next = 0 if j + 1 == n_theta else j + 1
    v = min(max((z - layout[2]) * layout[3], 0.0), n_z - 1.0)
    k = min(int(v), n_z - 2)
    return j * n_z + k, j_next * n_z + k, u - floor_u, v - k


@compiled(inline="always")
def skin_between(here: int, after: int, a: float, b: float, radius: Array) -> float:
    """Bilinear radius at a place found by `skin_cell` (compiled).

    Args:
        here: Flat index of the node before.
        after: Flat index of the next angle's node.
        a: Local θ in [0, 1].
        b: Local z in [0, 1].
        radius: Skin radius, flat [m].

    Returns:
        The radius [m].
    """
    first: float = (1.0 - b) * radius[here] + b * radius[here + 1]
    second: float = (1.0 - b) * radius[after] + b * radius[after + 1]
    return (1.0 - a) * first + a * second
