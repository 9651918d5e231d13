"""Simulated depth cameras above a torso on a table: noisy, one-sided, with holes."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.phantom.torso import Torso

#: Steps of the coarse search along a ray and of the bisection that follows
MARCH, BISECT = 160, 30


@dataclass(frozen=True)
class View:
    """One depth camera, patient frame.

    Attributes:
        eye: Position of the camera, shape (3,) [m].
        target: Point it looks at, shape (3,) [m].
        opening: Half of the field of view, in both directions [rad].
        pixels: Rows and columns of the square image [–].
    """

    eye: tuple[float, float, float]
    target: tuple[float, float, float] = (0.0, 0.0, 0.15)
    opening: float = 0.34
    pixels: int = 72

    def axes(self) -> Array:
        """Unit vectors to the right, up and ahead as rows, shape (3, 3) [–]."""
        ahead = np.asarray(self.target) - np.asarray(self.eye)
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(right, ahead), ahead])

    def rays(self) -> Array:
        """Unit directions of all pixels, lowest row first, shape (pixels², 3) [–]."""
        right, up, ahead = self.axes()
        step = np.tan(self.opening) * np.linspace(-1.0, 1.0, self.pixels)
        u, v = (g.reshape(-1, 1) for g in np.meshgrid(step, step))
        rays = ahead + u * right + v * up
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


@dataclass(frozen=True)
class ScanSetup:
    """The scene in front of the cameras, patient frame.

    Attributes:
        torso: The body, seen between its two ends.
        table: Height of the table, y [m].
        table_margin: Extent of the table beyond the body on every side [m].
        holes: Places on the skin without measurements: θ [rad], z and radius [m],
            shape (n, 3).
    """

    torso: Torso
    table: float = -0.121
    table_margin: float = 0.08
    holes: tuple[tuple[float, float, float], ...] = (
        (np.radians(140.0), 0.215, 0.018),
        (np.radians(50.0), 0.050, 0.022),
    )


def scan(
    setup: ScanSetup,
    views: tuple[View, ...],
    rng: np.random.Generator,
    *,
    noise: float = 0.002,
    dropout: float = 0.05,
) -> Array:
    """Measure one point cloud with several cameras.

    Args:
        setup: Body and table.
        views: The cameras.
        rng: Source of noise and dropouts.
        noise: Standard deviation along each ray [m].
        dropout: Fraction of pixels without a measurement [–].

    Returns:
        Points, patient frame, shape (n, 3) [m].

    Raises:
        InputError: There is no camera, or one sees nothing.
    """
    if not views:
        raise InputError("a scan needs at least one view, got none")
    clouds = []
    for view in views:
        distance = _measured(setup, view, rng, noise, dropout)
        seen = np.isfinite(distance)
        clouds.append(view.eye + distance[seen, None] * view.rays()[seen])
    return np.concatenate(clouds)


def depth_image(
    setup: ScanSetup,
    view: View,
    rng: np.random.Generator,
    *,
    noise: float = 0.002,
    dropout: float = 0.05,
) -> Array:
    """Measure one depth image; the arguments are those of `scan`.

    Returns:
        Depths along the camera's axis, top row first, NaN without a measurement,
        shape (pixels, pixels) [m].

    Raises:
        InputError: The camera sees nothing.
    """
    distance = _measured(setup, view, rng, noise, dropout)
    depth = distance * (view.rays() @ view.axes()[2])
    return np.asarray(depth.reshape(view.pixels, view.pixels)[::-1])


def _measured(
    setup: ScanSetup,
    view: View,
    rng: np.random.Generator,
    noise: float,
    dropout: float,
) -> Array:
    """Noisy distances along a camera's rays, NaN without a measurement [m]."""
    eye, rays = np.asarray(view.eye), view.rays()
    far = 2.0 * float(np.linalg.norm(eye - np.asarray(view.target)))
    distance = np.minimum(_to_skin(setup, eye, rays, far), _to_table(setup, eye, rays))
    seen = np.isfinite(distance) & (rng.random(len(rays)) >= dropout)
    noisy = distance + noise * rng.standard_normal(len(rays))
    seen[seen] &= ~_in_hole(setup, eye + distance[seen, None] * rays[seen])
    if not seen.any():
        raise InputError(f"the view from {view.eye} sees nothing: turn it around")
    return np.where(seen, noisy, np.nan)


def _to_skin(setup: ScanSetup, eye: Array, rays: Array, far: float) -> Array:
    """Distance to the skin along rays, inf if they miss it, NaN at the cut ends [m]."""

    def outside(distance: Array) -> NDArray[np.bool_]:
        x, y, z = (eye + distance[:, None] * rays).T
        reach = setup.torso.radius(np.arctan2(y, x), z)
        beyond = (z < 0.0) | (z > setup.torso.length)
        return np.asarray((np.hypot(x, y) > reach) | beyond)

    first = np.full(len(rays), np.inf)
    steps = np.linspace(0.0, far, MARCH)
    for distance in steps[::-1]:
        inside = ~outside(np.full(len(rays), distance))
        first[inside] = distance
    hit = np.isfinite(first)
    high = np.where(hit, first, 0.0)
    low = high - steps[1]
    for _ in range(BISECT):
        middle = 0.5 * (low + high)
        out = outside(middle)
        low, high = np.where(out, middle, low), np.where(out, high, middle)
    # A real body continues beyond its ends: a ray that enters there measures neither
    # the body nor the table behind it.
    z = eye[2] + high * rays[:, 2]
    end = 1e-4
    cut = (z < end) | (z > setup.torso.length - end)
    return np.where(hit, np.where(cut, np.nan, high), np.inf)


def _to_table(setup: ScanSetup, eye: Array, rays: Array) -> Array:
    """Distance to the table along rays, inf where they miss it [m]."""
    with np.errstate(divide="ignore"):
        distance = (setup.table - eye[1]) / rays[:, 1]
    distance = np.where(distance > 0.0, distance, np.inf)
    reached = np.isfinite(distance)
    margin = setup.table_margin
    x, _, z = (eye + np.where(reached, distance, 0.0)[:, None] * rays).T
    wide = setup.torso.half_axes[0] + margin
    on = (np.abs(x) < wide) & (z > -margin) & (z < setup.torso.length + margin)
    return np.where(reached & on, distance, np.inf)


def _in_hole(setup: ScanSetup, points: Array) -> NDArray[np.bool_]:
    """Whether each point lies in a hole, shape (n,)."""
    inside = np.zeros(len(points), dtype=bool)
    for theta, z, radius in setup.holes:
        middle = setup.torso.skin(np.array(theta), np.array(z))
        inside |= np.linalg.norm(points - middle, axis=1) < radius
    return inside


def write_cloud(points: Array, path: str | os.PathLike[str]) -> None:
    """Write points (n, 3) [m] as a binary PLY of 32-bit floats."""
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment metres\n"
        f"element vertex {len(points)}\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n"
    )
    io.write_bytes(path, header.encode() + points.astype("<f4").tobytes())
