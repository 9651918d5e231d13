"""The point shell sorted into compact blocks, most of which a frame can skip.

Points close to each other on the probe are stored next to each other, in blocks with a
bounding sphere each. A coarse table over the surface, the ceiling, holds an upper bound
of R over each tile of (θ, z), widened by the radius of a block. A block whose smallest
distance from the axis exceeds the ceiling at its centre cannot touch, so a frame looks
only at the points of the few blocks near the surface. No point in contact is missed:
the bounds have a margin above rounding.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.scan.surface import Surface

#: Points per block: four vectors of eight, and small against a contact patch
BLOCK = 32

#: Tiles of the ceiling table over the turn and over the height
TILES = (128, 64)

#: Added to every bound: far above rounding and far below a voxel [m]
MARGIN = 1e-9


@dataclass(frozen=True)
class ShellBlocks:
    """A shell's points in block order, with bounding spheres.

    Attributes:
        order: Index of each point in the shell, shape (M,).
        start: First point of each block, then the number of points, shape (B + 1,).
        centre: Centres of the bounding spheres, probe frame, shape (B, 3) [m].
        reach: Their radii, `MARGIN` included, shape (B,) [m].
    """

    order: NDArray[np.intp] = field(repr=False)
    start: NDArray[np.int64] = field(repr=False)
    centre: Array = field(repr=False)
    reach: Array = field(repr=False)

    @classmethod
    def of(cls, shell: PointShell) -> ShellBlocks:
        """Sort a shell into blocks of `BLOCK` points (the last may be smaller)."""
        order = np.arange(len(shell))
        _sort(order, shell.points)
        start = np.append(np.arange(0, len(shell), BLOCK), len(shell))
        # a smaller last block is filled up with its last point
        places = np.minimum(start[:-1, None] + np.arange(BLOCK), start[1:, None] - 1)
        centre, radius = _spheres(shell.points[order][places])
        return cls(order, start.astype(np.int64), centre, radius + MARGIN)


def _sort(order: NDArray[np.intp], points: Array) -> None:
    """Split at a whole number of blocks along the longest axis, in place."""
    blocks = -(-len(order) // BLOCK)
    if blocks < 2:
        return
    cut = BLOCK * (blocks // 2)
    here = points[order]
    axis = int(np.ptp(here, axis=0).argmax())
    order[:] = order[np.argpartition(here[:, axis], cut)]
    _sort(order[:cut], points)
    _sort(order[cut:], points)


def _spheres(blocks: Array) -> tuple[Array, Array]:
    """Nearly smallest bounding spheres of point sets, shape (B, n, 3) [m].

    Returns:
        Centres, shape (B, 3) [m], and radii, shape (B,) [m].
    """
    every = np.arange(len(blocks))
    centre = blocks.mean(axis=1)
    for step in range(2, 34):  # towards the farthest point by decreasing fractions
        away = blocks - centre[:, None]
        farthest = np.einsum("bnd,bnd->bn", away, away).argmax(axis=1)
        centre += away[every, farthest] / step
    away = blocks - centre[:, None]
    return centre, np.sqrt(np.einsum("bnd,bnd->bn", away, away).max(axis=1))


class Tiles(NamedTuple):
    """Layout of the tiles of a ceiling, and the range in which its bounds hold.

    Attributes:
        floor: Smallest R anywhere [m]: the bounds are for spheres whose centre is at
            least this far from the axis.
        per_theta: Tiles per radian.
        z_0: First height [m].
        per_z: Tiles per metre.
    """

    floor: float
    per_theta: float
    z_0: float
    per_z: float


@dataclass(frozen=True)
class SurfaceCeiling:
    """Upper bounds of the surface's radius over coarse tiles.

    Attributes:
        ceiling: Largest R over a tile and around it, shape `TILES` [m].
        tiles: Layout of the tiles.
    """

    ceiling: Array = field(repr=False)
    tiles: Tiles

    @classmethod
    def of(cls, surface: Surface, reach: float) -> SurfaceCeiling:
        """Tabulate a surface for blocks of at most ``reach`` [m]."""
        n_theta, n_z = TILES
        floor = float(surface.radius.min())
        # half the angle that a sphere beyond the floor spans at most
        half = math.asin(min(1.0, reach / floor)) if reach < floor else math.pi
        z0, z1 = float(surface.z[0]), float(surface.z[-1])
        tile_theta, tile_z = 2.0 * math.pi / n_theta, (z1 - z0) / n_z
        over_z = np.stack(
            [
                _window(surface, z0 + k * tile_z - reach, z0 + (k + 1) * tile_z + reach)
                for k in range(n_z)
            ],
            axis=1,
        )
        step = 2.0 * math.pi / len(surface.theta)
        ceiling = np.empty(TILES)
        for j in range(n_theta):
            # nodes on either side of the widened tile bound the bilinear interpolant
            low = math.floor((j * tile_theta - half - surface.theta[0]) / step - 1e-6)
            high = math.ceil(
                ((j + 1) * tile_theta + half - surface.theta[0]) / step + 1e-6
            )
            nodes = np.arange(low, high + 1)[: len(surface.theta)] % len(surface.theta)
            ceiling[j] = over_z[nodes].max(axis=0)
        return cls(ceiling + MARGIN, Tiles(floor, 1.0 / tile_theta, z0, 1.0 / tile_z))


def _window(surface: Surface, low: float, high: float) -> Array:
    """Largest R per angle over heights from low to high [m], shape (n_theta,)."""
    n_z = len(surface.z)
    step = (surface.z[-1] - surface.z[0]) / (n_z - 1)
    first = math.floor((low - surface.z[0]) / step - 1e-6)
    last = math.ceil((high - surface.z[0]) / step + 1e-6)
    first, last = min(max(first, 0), n_z - 1), min(max(last, 0), n_z - 1)
    return np.asarray(surface.radius[:, first : last + 1].max(axis=1))
