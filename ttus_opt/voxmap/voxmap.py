"""The voxmap: which voxels lie inside the patient, on its surface, and outside.

The voxels nearest to the surface R(θ, z) along their spoke form the surface layer. It
is closed at its steps between neighbouring spokes, so that inside and outside never
couple (docs/method/surface.md, Voxmap). Where the surface is a grid layer, the surface
layer is exactly that layer. There are two ways to close it, and two meanings of its
value:

- ``subvoxel``: every voxel below the layer stays inside; voxels outside that would
  touch one join the layer. The layer's value holds at the true radius, where the
  surface cuts the links to it (`ttus_opt.voxmap.cut_links`).
- ``staircase`` (the paper): of each pair that would touch, the voxel nearer to the
  surface joins the layer. The layer's value holds at the voxels' centres.

The wall of a sector (`ttus_opt.voxmap.grid`) belongs to the layer entirely: it is
fixed, and couples nothing.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arguments import expect_one_of
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import GeometryError, InputError
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.cut_links import CutLinks
from ttus_opt.voxmap.grid import (
    BYTES_PER_VOXEL,
    CylindricalGrid,
    Sector,
    check_seen,
    checked_sector,
    largest_radius,
    nodes_of,
)

#: Default distance of the outer layer from the largest surface radius [m]
OUTER_MARGIN = 0.02

INSIDE, SURFACE, OUTSIDE = 1, 0, -1

#: Where the surface layer's value holds: at the true radius, or at the voxels' centres
Boundary = Literal["subvoxel", "staircase"]


@dataclass(frozen=True, eq=False)
class Voxmap:
    """A grid laid over a surface.

    Attributes:
        grid: Voxel centres.
        surface: The patient's surface; a point is inside when r < R(θ, z).
        region: `INSIDE`, `SURFACE` or `OUTSIDE` per voxel, shape ``grid.shape``.
        boundary: ``subvoxel`` or ``staircase``.
    """

    grid: CylindricalGrid
    surface: Surface = field(repr=False)
    region: NDArray[np.int8] = field(repr=False)
    boundary: str = "staircase"

    def __post_init__(self) -> None:
        """Validate boundary, and regions by shape and value."""
        expect_one_of(self.boundary, get_args(Boundary), "boundary")
        if self.region.shape != self.grid.shape:
            raise InputError(
                f"region must have the grid's shape {self.grid.shape}, got "
                f"{self.region.shape}"
            )
        if not np.isin(self.region, (INSIDE, SURFACE, OUTSIDE)).all():
            raise InputError(
                f"region must hold {INSIDE} inside, {SURFACE} on the surface and "
                f"{OUTSIDE} outside only"
            )

    def __repr__(self) -> str:
        return f"Voxmap({self.grid.extent})"

    @classmethod
    def from_surface(
        cls,
        surface: Surface,
        *,
        shape: Sequence[int] = (48, 120, 60),
        r_inner: float = 0.03,
        r_outer: float | None = None,
        memory_limit: float | None = None,
        boundary: str = "subvoxel",
        sector: Sector | None = None,
    ) -> Voxmap:
        """Lay a grid over a surface and classify its voxels.

        Args:
            surface: The patient.
            shape: Counts (n_r, n_theta, n_z) [–].
            r_inner: Radius of the inner layer, inside the patient everywhere [m].
            r_outer: Radius of the outer layer; by default the largest surface
                radius and 20 mm more [m].
            memory_limit: Most memory a fit on this grid may take; by default the
                machine's free memory [bytes].
            boundary: ``subvoxel``, or ``staircase`` as in the paper.
            sector: First and last angle of the grid, with zero flux at both [rad]; None
                for the full turn. One spoke of ``shape`` is then the wall.

        Raises:
            InputError: An invalid count, an unknown boundary, an invalid sector or one
                in which the surface was not seen, or a grid that would not fit in
                memory (estimated before anything is allocated).
            GeometryError: The surface does not lie between the two layers.
        """
        expect_one_of(boundary, get_args(Boundary), "boundary")
        counts = tuple(shape)
        if len(counts) != 3 or any(int(n) != n for n in counts):
            raise InputError(f"shape must be three whole numbers, got {tuple(shape)}")
        check_seen(surface, checked_sector(sector))
        outer = largest_radius(surface, sector) + OUTER_MARGIN
        grid = CylindricalGrid(
            float(r_inner),
            outer if r_outer is None else float(r_outer),
            float(surface.z[0]),
            float(surface.z[-1]),
            (int(counts[0]), int(counts[1]), int(counts[2])),
            sector,
        )
        check_memory(grid, memory_limit)
        return cls._over(surface, grid, boundary)

    @classmethod
    def _over(cls, surface: Surface, grid: CylindricalGrid, boundary: str) -> Voxmap:
        theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
        radius = surface.radius_at(theta, z)
        crest = largest_radius(surface, grid.sector)  # perhaps between two spokes
        _check_radius(float(radius[: grid.wall].min()), crest, grid)
        classify = _thickened if boundary == "staircase" else _enclosed
        return cls(grid, surface, classify(grid, radius), boundary)

    def raised(self, height: float) -> Voxmap:
        """The same grid over a surface farther from the axis by a height [m].

        Raises:
            GeometryError: That surface does not lie between the two layers.
        """
        return self._over(self.surface.raised(height), self.grid, self.boundary)

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Voxels of the patient without its surface layer, shape ``grid.shape``."""
        return np.asarray(self.region == INSIDE)

    @property
    def on_surface(self) -> NDArray[np.bool_]:
        """Voxels of the surface layer, shape ``grid.shape``."""
        return np.asarray(self.region == SURFACE)

    @property
    def dirichlet(self) -> NDArray[np.bool_]:
        """Voxels with a given value: surface, inner, outer layer and both ends."""
        fixed = self.on_surface.copy()
        fixed[[0, -1]] = True
        fixed[:, :, [0, -1]] = True
        return fixed

    @cached_property
    def spoke_radius(self) -> Array:
        """The surface's radius on every spoke of the grid, (n_theta, n_z) [m]."""
        return self.surface.radius_at(self.grid.theta[:, None], self.grid.z)

    @cached_property
    def spoke_cosine(self) -> Array:
        """Cosine between spoke and surface's normal on every spoke, as above [–]."""
        theta, z, R = self.grid.theta[:, None], self.grid.z, self.surface.radius_at
        turn, step, ends = (
            self.grid.theta_step,
            self.grid.z_step,
            self.surface.z[[0, -1]],
        )
        around = (R(theta + turn, z) - R(theta - turn, z)) / (2.0 * turn)
        low, high = np.clip(z - step, *ends), np.clip(z + step, *ends)
        along = (R(theta, high) - R(theta, low)) / (high - low)
        return np.asarray(1.0 / np.sqrt(1.0 + (around / R(theta, z)) ** 2 + along**2))

    @property
    def surface_place(self) -> Array:
        """(R − r_inner)/Δr on every spoke of the grid, (n_theta, n_z) [layers]."""
        return (self.spoke_radius - self.grid.r_inner) / self.grid.r_step

    @cached_property
    def cut_links(self) -> CutLinks:
        """Links to the surface layer that the surface cuts, and those to a wall.

        In a staircase the surface cuts none.
        """
        wall, is_staircase = self.grid.wall, self.boundary == "staircase"
        if is_staircase and wall is None:
            return CutLinks.none()
        links = CutLinks.of(self.region, self.surface_place, wall)
        if is_staircase:
            return links.only(nodes_of(links.neighbours, self.grid.shape)[1] == wall)
        return links


def check_memory(grid: CylindricalGrid, limit: float | None = None) -> None:
    """Compare the memory of a fit on a grid with a limit; default: free memory [byte].

    Raises:
        InputError: It needs more.
    """
    if limit is None:
        limit = float(os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    need = grid.n_voxels * BYTES_PER_VOXEL
    if need > limit:
        raise InputError(
            f"a fit on {'x'.join(map(str, grid.shape))} = {grid.n_voxels:,} voxels "
            f"takes about {need / 2**30:.1f} GiB, {limit / 2**30:.1f} GiB are free: "
            "choose a smaller shape"
        )


def _check_radius(low: float, high: float, grid: CylindricalGrid) -> None:
    if low <= grid.r_inner + grid.r_step / 2:
        raise GeometryError(
            f"the surface comes within {low:.4g} m of the axis, r_inner is "
            f"{grid.r_inner:.4g} m: choose r_inner below {low - grid.r_step / 2:.3g} "
            "or move the axis"
        )
    if high > grid.r_outer:
        raise GeometryError(
            f"the surface reaches {high:.4g} m, r_outer is {grid.r_outer:.4g} m: "
            "choose a larger r_outer or leave it out"
        )


def surface_layer(grid: CylindricalGrid, radius: Array) -> NDArray[np.int64]:
    """The layer nearest to a surface of any shape [m], the lower one of two equals."""
    # the margin keeps a radius on a layer at that layer despite rounding
    layer = np.ceil((radius - grid.r_inner) / grid.r_step - 0.5 - 1e-9)
    return np.asarray(layer.astype(np.int64))


def _layers(grid: CylindricalGrid, radius: Array) -> NDArray[np.int8]:
    """Region of every voxel by its own spoke alone; radii at (θ_j, z_k) [m]."""
    index = np.arange(grid.shape[0])[:, None, None]
    region = np.sign(surface_layer(grid, radius)[None] - index).astype(np.int8)
    if grid.wall is not None:
        region[:, grid.wall] = SURFACE
    return np.asarray(region)


def _enclosed(grid: CylindricalGrid, radius: Array) -> NDArray[np.int8]:
    """Regions with a layer closed by voxels from outside."""
    region = _layers(grid, radius)
    inside = region == INSIDE
    touches = np.zeros_like(inside)
    touches[1:] |= inside[:-1]
    touches |= np.roll(inside, 1, 1) | np.roll(inside, -1, 1)
    touches[:, :, 1:] |= inside[:, :, :-1]
    touches[:, :, :-1] |= inside[:, :, 1:]
    region[touches & ~inside] = SURFACE
    return region


def _thickened(grid: CylindricalGrid, radius: Array) -> NDArray[np.int8]:
    """Regions with a layer closed by the nearer voxel of every pair."""
    distance = np.abs(radius[None] - grid.r[:, None, None]) / grid.r_step  # [voxels]
    region = _layers(grid, radius)
    closed = region.copy()
    for axis, wraps in ((1, True), (2, False)):
        # ``out`` is a view of ``closed``
        out, own, far = (np.moveaxis(a, axis, 0) for a in (closed, region, distance))
        here = np.arange(len(own) if wraps else len(own) - 1)
        there = (here + 1) % len(own)
        crossing, first = own[here] * own[there] == -1, far[here] <= far[there]
        for side, nearer in ((here, first), (there, ~first)):
            out[side] = np.where(crossing & nearer, SURFACE, out[side])
    return np.asarray(closed)
