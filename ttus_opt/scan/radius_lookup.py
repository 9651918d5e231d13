"""The surface's radius R(θ, z) at a place: bilinear, periodic in θ, constant beyond z.

The only lookup of the package: `Surface.radius_at`, the rows of the fit and the haptic
frame all use it, so that they agree to the last bit on what is inside. Finding the cell
and interpolating are separate functions, because the first is arithmetic only, which
compiled loops vectorise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.compiled import compiled


class RadiusLayout(NamedTuple):
    """Positions of a surface's nodes.

    Attributes:
        theta_0: First angle, in [0, 2π) [rad].
        per_theta: Nodes per radian.
        z_0: First height [m].
        per_z: Nodes per metre.
    """

    theta_0: float
    per_theta: float
    z_0: float
    per_z: float


@compiled(inline="always")
def radius_cell(
    theta: float, z: float, n_theta: int, n_z: int, layout: RadiusLayout
) -> tuple[int, int, float, float]:
    """The cell of nodes around a place, without a branch (compiled).

    Args:
        theta: Angle in [0, 2π) [rad].
        z: Height [m].
        n_theta: Angles of the surface [–].
        n_z: Slices of the surface [–].
        layout: `Surface.kernel_layout`.

    Returns:
        Flat index of the node before and of the next angle's, then the local (θ, z).
    """
    u = (theta - layout.theta_0) * layout.per_theta
    floor_u = np.floor(u)  # math.floor makes an integer and no vector instruction
    j = int(floor_u)
    j = j + n_theta if j < 0 else j
    j = j - n_theta if j >= n_theta else j
    j_next = 0 if j + 1 == n_theta else j + 1
    v = min(max((z - layout.z_0) * layout.per_z, 0.0), n_z - 1.0)
    k = min(int(v), n_z - 2)
    return j * n_z + k, j_next * n_z + k, u - floor_u, v - k


@compiled(inline="always")
def radius_between(here: int, after: int, a: float, b: float, radius: Array) -> float:
    """Bilinear radius at a place found by `radius_cell`, nodes flat [m] (compiled)."""
    first: float = (1.0 - b) * radius[here] + b * radius[here + 1]
    second: float = (1.0 - b) * radius[after] + b * radius[after + 1]
    return (1.0 - a) * first + a * second


def radii_at(theta: Array, z: Array, radius: Array, layout: RadiusLayout) -> Array:
    """Radii at places, shape (n,) [m].

    Args:
        theta: Angles in [0, 2π), shape (n,) [rad].
        z: Heights, shape (n,) [m].
        radius: Radius of the nodes, shape (n_theta, n_z) [m].
        layout: `Surface.kernel_layout`.
    """
    out = np.empty(theta.size)
    _set_radii(out, theta, z, radius.reshape(-1), radius.shape, layout)
    return out


@compiled()
def _set_radii(
    out: Array,
    theta: Array,
    z: Array,
    radius: Array,
    nodes: tuple[int, int],
    layout: RadiusLayout,
) -> None:
    """`radii_at` for flat radii (compiled)."""
    for m in range(out.size):
        here, after, a, b = radius_cell(theta[m], z[m], nodes[0], nodes[1], layout)
        out[m] = radius_between(here, after, a, b, radius)
