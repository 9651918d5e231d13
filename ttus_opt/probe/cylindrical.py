"""Cylindrical coordinates of points, and the polar angle for compiled loops.

The rows of the fit and the haptic frame must agree on the voxel that contains a point,
so both compute the angle with `turn_angle`. It has no branches and calls no library, so
that loops over points are vectorised. Its relative error is below 4e-16.
"""

from __future__ import annotations

import math

import numpy as np

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.compiled import compiled

TURN = 2.0 * math.pi

#: tan(π/8): below it the series gives atan itself, above it the difference from π/4
_SEAM = math.sqrt(2.0) - 1.0

# (atan(t)/t − 1)/t² as a polynomial in t² up to tan²(π/8), by interpolation at
# Chebyshev nodes in extended precision: 9e-18 relative
_C0, _C1, _C2, _C3, _C4, _C5 = (
    -0.3333333333333333,
    0.1999999999999532,
    -0.14285714284651893,
    0.11111111014746207,
    -0.09090904568549744,
    0.07692183092493075,
)
_C6, _C7, _C8, _C9, _C10 = (
    -0.06664510978707411,
    0.05858149260934077,
    -0.05085464851919358,
    0.03923231915386155,
    -0.019177856021021778,
)


@compiled(inline="always")
def turn_angle(x: float, y: float) -> float:
    """Angle of (x, y) in [0, 2π), 0 at the origin [rad] (compiled)."""
    across, along = abs(y), abs(x)
    high = max(max(across, along), 1e-300)  # avoids division by zero
    low = min(across, along)
    steep = low > _SEAM * high
    t = (low - high if steep else low) / (low + high if steep else high)
    s = t * t
    # fmt: off
    q = ((((((((((_C10 * s + _C9) * s + _C8) * s + _C7) * s + _C6) * s + _C5) * s
        + _C4) * s + _C3) * s + _C2) * s + _C1) * s + _C0) * s
    # fmt: on
    theta = t + t * q
    theta = 0.25 * math.pi + theta if steep else theta
    theta = 0.5 * math.pi - theta if across > along else theta
    theta = math.pi - theta if x < 0.0 else theta
    theta = TURN - theta if y < 0.0 else theta
    return 0.0 if theta >= TURN else theta  # 2π − 1e-17 rounds to 2π


def cylindrical(points: Array) -> tuple[Array, Array, Array]:
    """Cylindrical coordinates of points.

    Args:
        points: Patient frame, shape (n, 3) [m].

    Returns:
        r [m], θ in [0, 2π) [rad] and z [m], each of shape (n,).
    """
    r = np.hypot(points[:, 0], points[:, 1])
    theta = np.arctan2(points[:, 1], points[:, 0])
    # −1e-17 % 2π rounds up to 2π itself
    return r, theta % TURN % TURN, points[:, 2].copy()


def lattice_shares(
    theta: Array, along: Array, shape: tuple[int, int]
) -> list[tuple[IntArray, Array]]:
    """The four nodes of a lattice around places, and their bilinear shares.

    Args:
        theta: Angles [rad]; the lattice closes around.
        along: From 0 at its lower to 1 at its upper end; beyond, those of the end [–].
        shape: Nodes around and along.

    Returns:
        Numbers of nodes in C order, and shares, which add up to 1, of each corner.
    """
    around, high = shape
    a, b = (theta % TURN) * around / TURN, np.clip(along, 0.0, 1.0) * (high - 1)
    i, j = np.asarray(a).astype(int), np.minimum(np.asarray(b).astype(int), high - 2)
    s, t = a - i, b - j
    return [
        (
            ((i + u) % around) * high + j + v,
            (s if u else 1.0 - s) * (t if v else 1.0 - t),
        )
        for u in (0, 1)
        for v in (0, 1)
    ]
