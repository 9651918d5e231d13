"""A plane section of a field: axial, or along the body through its axis."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.ndimage import map_coordinates

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.probe.cylindrical import TURN, cylindrical
from ttus_opt.voxmap.field import PotentialField

Direction = Literal["axial", "along"]

#: Distance between samples [m]
PIXEL = 0.0008

#: The scale covers values down to this depth below the skin, deeper than a press [m]
DEPTH = 0.04

#: Isolines between zero and the end of the scale [–]
LINES = 10


@dataclass(frozen=True)
class Section:
    """Values of a field on a plane.

    Attributes:
        origin: Middle of the plane, patient frame, shape (3,) [m].
        across: Unit vector of its columns, shape (3,) [–].
        up: Unit vector of its rows, from the last to the first, shape (3,) [–].
        size: Width and height [m].
        values: Of the field, NaN beyond the skin or the model, shape (rows, columns)
            [unit of the field].
        top: End of the scale [unit of the field].
    """

    origin: Array
    across: Array
    up: Array
    size: tuple[float, float]
    values: Array = field(repr=False)
    top: float

    @property
    def normal(self) -> Array:
        """Of the plane, shape (3,) [–]."""
        return np.cross(self.across, self.up)

    @property
    def step(self) -> float:
        """Between isolines, a round number [unit of the field]."""
        least = self.top / LINES
        power = 10.0 ** math.floor(math.log10(least))
        return next(s * power for s in (1.0, 2.0, 5.0, 10.0) if s * power >= least)

    @property
    def isolines(self) -> Mask:
        """Samples on an isoline, shape (rows, columns)."""
        band = np.floor(self.values / self.step)
        out = np.zeros(band.shape, dtype=bool)
        down, right = band[1:] != band[:-1], band[:, 1:] != band[:, :-1]
        known = np.isfinite(self.values)
        out[1:] |= down & known[1:] & known[:-1]
        out[:, 1:] |= right & known[:, 1:] & known[:, :-1]
        return out & (self.values <= self.top)


def section(potential: PotentialField, direction: Direction, at: float) -> Section:
    """Sample a field on a plane, linear between voxels.

    Args:
        potential: The field.
        direction: "axial" or "along".
        at: Height [m], or angle [rad] of the half plane on the right.
    """
    surface, grid = potential.voxmap.surface, potential.voxmap.grid
    low, high = float(surface.z[0]), float(surface.z[-1])
    reach = 1.02 * float(surface.radius.max())
    if direction == "axial":
        across, up = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
        origin, size = np.array([0.0, 0.0, at]), (2.0 * reach, 2.0 * reach)
    else:
        across = np.array([math.cos(at), math.sin(at), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        origin = np.array([0.0, 0.0, 0.5 * (low + high)])
        size = 2.0 * reach, high - low
    columns, rows = (max(round(s / PIXEL), 2) for s in size)
    u = (np.arange(columns) + 0.5) / columns * size[0] - 0.5 * size[0]
    v = 0.5 * size[1] - (np.arange(rows) + 0.5) / rows * size[1]
    points = origin + u[None, :, None] * across + v[:, None, None] * up
    flat = points.reshape(-1, 3)
    values = sampled(potential, flat)
    r, theta, z = cylindrical(flat)
    depth = surface.radius_at(theta, z) - r
    values[depth < 0.0] = np.nan
    below = potential.voxmap.spoke_radius[None] - grid.r[:, None, None]
    shallow = (below > 0.0) & (below < DEPTH)
    top = float(np.quantile(potential.values[shallow], 0.99)) if shallow.any() else 1.0
    top = max(top, np.finfo(float).tiny)
    return Section(origin, across, up, size, values.reshape(rows, columns), top)


def sampled(potential: PotentialField, points: Array) -> Array:
    """A field at points, linear between its voxels; inside the inner layer as on it.

    Args:
        potential: The field.
        points: Patient frame, shape (n, 3) [m].

    Returns:
        Shape (n,), NaN beyond the grid [unit of the field].
    """
    grid = potential.voxmap.grid
    r, theta, z = cylindrical(points)
    values = potential.values
    if grid.sector is None:  # the first spoke once more behind the last
        turn = theta % TURN / grid.theta_step
        values = np.concatenate([values, values[:, :1]], axis=1)
    else:  # up to its sides; the last spoke is the wall
        turn = (theta - grid.sector[0]) % TURN / grid.theta_step - 0.5
        turn = np.clip(turn, 0.0, grid.shape[1] - 2.0)
    layer = np.maximum((r - grid.r_inner) / grid.r_step, 0.0)
    place = [layer, turn, (z - grid.z_min) / grid.z_step]
    out = map_coordinates(values, place, order=1, cval=np.nan)
    out[~grid.in_sector(theta)] = np.nan
    return np.asarray(out)
