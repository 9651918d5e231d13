"""The cylindrical voxel grid: positions of its voxels, and the layout of arrays.

Voxel values have shape (n_r, n_theta, n_z) and are flattened in C order. Only this
module knows the order; compiled kernels use its `flat_index`.

A grid covers the full turn, or a sector of θ with zero flux at its two sides. Spokes of
a sector lie at the centres of equal parts, so that its sides are faces of voxels. One
more spoke, the last, is a wall: it interrupts the circle on which neighbours in θ are
taken. Its voxels are fixed, and their links conduct nothing
(`ttus_opt.voxmap.cut_links`).
An organ, or a belly seen from the front, needs no back: a grid over the seen sector
does not depend on the unseen surface. Nothing flows through its sides, as if the body
continued beyond each as its mirror image.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arguments import expect_shape, expect_whole
from ttus_opt.core.arrays import Array
from ttus_opt.core.compiled import compiled
from ttus_opt.core.errors import GeometryError, InputError
from ttus_opt.probe.cylindrical import TURN
from ttus_opt.scan.surface import Surface

#: From and to [rad]
Sector = tuple[float, float]

#: The narrowest sector: about 10 mm on a body, less than a probe's width, where
#: multigrid still converges with as many spokes as a full turn has [rad]
NARROWEST = math.radians(5.0)


def checked_sector(sector: Sector | None) -> Sector | None:
    """The sector, validated.

    Raises:
        InputError: Not two finite angles, not less than a full turn, or too narrow.
    """
    if sector is None:
        return None
    if len(sector) != 2 or not all(abs(v) <= 2.0 * TURN for v in sector):
        with np.errstate(over="ignore"):  # infinity is shown as such
            got = " to ".join(f"{v:.4g}°" for v in np.degrees(sector[:3]))
        raise InputError(
            f"a sector is two angles between -720° and 720°, got {got or 'none'}"
        )
    low, high = float(sector[0]), float(sector[1])
    if not 0.0 < high - low < TURN:
        raise InputError(
            "a sector goes from an angle to a larger one, by less than a full turn, "
            f"got {in_degrees(sector)}: across 0° write -60,60, for the whole leave it "
            "out"
        )
    if high - low < NARROWEST * (1.0 - 1e-9):
        raise InputError(
            f"a sector of {math.degrees(high - low):.4g}° is less than the width of a "
            f"probe: give at least {math.degrees(NARROWEST):g}°"
        )
    return low, high


def in_degrees(sector: Sector) -> str:
    """A sector in degrees, as text.

    >>> in_degrees((0.0, 3.14159265))
    '0° to 180°'
    """
    low, high = np.degrees(sector)
    return f"{low:.4g}° to {high:.4g}°"


def holds(sector: Sector, theta: Array) -> NDArray[np.bool_]:
    """Whether angles lie in a sector, any shape [rad]."""
    low, high = sector
    return np.asarray((np.asarray(theta) - low) % TURN <= high - low)


def check_seen(surface: Surface, sector: Sector | None) -> None:
    """Refuse a sector with angles at which the scan saw nothing.

    A hole at some heights of an angle is filled, as in the full turn.

    Raises:
        InputError: There are such angles.
    """
    if sector is None:
        return
    inside = holds(sector, surface.theta)
    seen = np.asarray(surface.observed.any(axis=1))
    unseen = int((inside & ~seen).sum())
    if unseen:
        known = _longest(seen, surface.theta)
        part = "" if known is None else in_degrees(known)
        advice = f"choose one within {part}" if part else "scan it"
        raise InputError(
            f"the scan saw no skin at {unseen} of {int(inside.sum())} angles of the "
            f"sector {in_degrees(sector)}: {advice}"
        )


def largest_radius(surface: Surface, sector: Sector | None) -> float:
    """The largest radius of the surface in a sector, or all around [m]."""
    if sector is None:
        return float(surface.radius.max())
    nodes = surface.theta[holds(sector, surface.theta)]
    angles = np.concatenate([sector, nodes])
    return float(surface.radius_at(angles[:, None], surface.z).max())


def _longest(seen: NDArray[np.bool_], theta: Array) -> Sector | None:
    """The longest run of seen angles around the circle; None without any."""
    if not seen.any():
        return None
    n = len(seen)
    gaps = np.flatnonzero(~seen)
    runs = np.diff(gaps, append=gaps[0] + n) - 1
    first = int(gaps[runs.argmax()]) + 1
    step = TURN / n
    low = float(theta[0]) + step * (first % n)
    return low, low + step * (int(runs.max()) - 1)


#: Memory of a fit by the structured solver per voxel (L, the multigrid, a dozen
#: vectors): 420 measured on case L with 400 poses, voxel-mean [byte]
BYTES_PER_VOXEL = 450

#: Most voxels along an axis
MOST_LAYERS = 1_000_000


class GridLimits(NamedTuple):
    """A grid's extent and voxels per unit, for compiled kernels.

    Attributes:
        r_inner: Radius of the innermost layer [m].
        per_r: Layers per metre.
        r_outer: Radius of the outermost layer [m].
        per_theta: Spokes per radian.
        z_min: Height of the first slice [m].
        per_z: Slices per metre.
        z_max: Height of the last slice [m].
        theta_0: First angle of the grid, in [0, 2π) [rad].
        width: Angle that it covers [rad].
        shift: Distance from ``theta_0`` to the first spoke, in spokes.
        last_cell: Index of the last pair of neighbouring spokes.
    """

    r_inner: float
    per_r: float
    r_outer: float
    per_theta: float
    z_min: float
    per_z: float
    z_max: float
    theta_0: float
    width: float
    shift: float
    last_cell: float


@dataclass(frozen=True)
class CylindricalGrid:
    """Voxel centres on constant steps in r, θ and z.

    Attributes:
        r_inner: Radius of the innermost layer of centres [m].
        r_outer: Radius of the outermost layer of centres [m].
        z_min: Height of the first slice [m].
        z_max: Height of the last slice [m].
        shape: Counts (n_r, n_theta, n_z); of a sector the wall counts as a spoke [–].
        sector: First and last angle of the grid, with zero flux at both [rad]; None for
            the full turn.
    """

    r_inner: float
    r_outer: float
    z_min: float
    z_max: float
    shape: tuple[int, int, int]
    sector: Sector | None = None

    def __post_init__(self) -> None:
        """Validate the grid.

        Raises:
            InputError: Too few layers, limits not finite, or an invalid sector.
            GeometryError: Limits out of order, or the first layer on the axis.
        """
        minima = {"n_r": 4, "n_theta": 4, "n_z": 3}
        if len(self.shape) != 3:
            raise InputError(
                f"shape must be (n_r, n_theta, n_z), got {self.shape}: give 3 counts"
            )
        for (name, least), count in zip(minima.items(), self.shape, strict=True):
            expect_whole(count, least, MOST_LAYERS, name)
        checked_sector(self.sector)
        for name in ("r_inner", "r_outer", "z_min", "z_max"):
            if not math.isfinite(getattr(self, name)):
                raise InputError(
                    f"{name} must be finite [m], got {getattr(self, name)}"
                )
        for high, low in (("r_outer", "r_inner"), ("z_max", "z_min")):
            top, bottom = getattr(self, high), getattr(self, low)
            if not top > bottom:
                raise GeometryError(
                    f"{high} {top:.4g} m must exceed {low} {bottom:.4g} m"
                )
        if self.r_inner < self.r_step / 2:
            raise GeometryError(
                f"r_inner {self.r_inner:.4g} m is less than half a radial step "
                f"({self.r_step / 2:.4g} m): the axis itself has no voxel, choose a "
                "larger r_inner"
            )

    @property
    def n_voxels(self) -> int:
        """Number of voxels V [–]."""
        return math.prod(self.shape)

    def __repr__(self) -> str:
        return f"CylindricalGrid({self.extent})"

    @property
    def extent(self) -> str:
        """Counts and extent, as text."""
        sector = "" if self.sector is None else f"θ {in_degrees(self.sector)}, "
        return (
            f"{self.sizes}, r {100 * self.r_inner:.1f} to {100 * self.r_outer:.1f} cm, "
            f"{sector}z {100 * self.z_min:.1f} to {100 * self.z_max:.1f} cm"
        )

    @property
    def sizes(self) -> str:
        """Counts and their product, as text."""
        return f"{'×'.join(map(str, self.shape))} = {self.n_voxels:,} voxels"

    @property
    def r_step(self) -> float:
        """Radial step Δr [m]."""
        return (self.r_outer - self.r_inner) / (self.shape[0] - 1)

    @property
    def theta_step(self) -> float:
        """Angular step Δθ [rad]."""
        if self.sector is None:
            return TURN / self.shape[1]
        return (self.sector[1] - self.sector[0]) / (self.shape[1] - 1)

    @property
    def wall(self) -> int | None:
        """The wall of a sector, the last spoke; None for the full turn."""
        return None if self.sector is None else self.shape[1] - 1

    @property
    def z_step(self) -> float:
        """Step along the axis Δz [m]."""
        return (self.z_max - self.z_min) / (self.shape[2] - 1)

    @property
    def r(self) -> Array:
        """Radii of the layers, shape (n_r,) [m]."""
        return self.r_inner + self.r_step * np.arange(self.shape[0], dtype=float)

    @property
    def theta(self) -> Array:
        """Angles of the spokes, shape (n_theta,) [rad]."""
        if self.sector is None:
            return self.theta_step * np.arange(self.shape[1], dtype=float)
        middles = 0.5 + np.arange(self.shape[1], dtype=float)
        return self.sector[0] + self.theta_step * middles

    def in_sector(self, theta: Array) -> NDArray[np.bool_]:
        """Whether angles lie in the sector, any shape [rad]; all do in a full turn."""
        if self.sector is None:
            return np.ones(np.shape(theta), dtype=bool)
        return holds(self.sector, theta)

    @property
    def z(self) -> Array:
        """Heights of the slices, shape (n_z,) [m]."""
        return self.z_min + self.z_step * np.arange(self.shape[2], dtype=float)

    @property
    def strides(self) -> tuple[int, int, int]:
        """Flat distance between neighbours in r, θ and z [–]."""
        return (self.shape[1] * self.shape[2], self.shape[2], 1)

    def flatten(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values (n_r, n_theta, n_z) as a flat vector (V,).

        Raises:
            InputError: The array has another shape.
        """
        values = np.asarray(values)
        expect_shape(values, self.shape, "voxel values")
        return values.reshape(-1)

    def unflatten(self, vector: NDArray[Any]) -> NDArray[Any]:
        """A flat vector (V,) as values (n_r, n_theta, n_z).

        Raises:
            InputError: The vector has another length.
        """
        vector = np.asarray(vector)
        expect_shape(vector, (self.n_voxels,), "a voxel vector")
        return vector.reshape(self.shape)

    @property
    def kernel_limits(self) -> GridLimits:
        """Extent and steps, for compiled kernels."""
        around = 0.0, TURN, 0.0, self.shape[1] - 1.0
        if self.sector is not None:
            low, high = self.sector
            around = low % TURN, high - low, 0.5, self.shape[1] - 3.0
        return GridLimits(
            float(self.r_inner),
            1.0 / self.r_step,
            float(self.r_outer),
            1.0 / self.theta_step,
            float(self.z_min),
            1.0 / self.z_step,
            float(self.z_max),
            *around,
        )


def nodes_of(
    voxels: NDArray[np.integer], shape: tuple[int, int, int]
) -> tuple[NDArray[np.int64], ...]:
    """Layer, spoke and slice of voxels with flat indices (k,), shape (k,) each [–]."""
    return np.unravel_index(voxels, shape)


@compiled(inline="always")
def flat_index(i: int, j: int, k: int, n_theta: int, n_z: int) -> int:
    """Flat index of voxel (i, j, k): C order (compiled)."""
    return (i * n_theta + j) * n_z + k


@compiled(inline="always")
def depth_at(skin: float, r: float, z: float, limits: GridLimits) -> float:
    """Depth below the surface, faded to 0 over the voxel at either end (compiled) [m].

    The patient goes on beyond the grid: without this, a force would jump there. The
    fade is continuous, and 1 elsewhere.
    """
    share = min(z - limits.z_min, limits.z_max - z) * limits.per_z
    faded: float = (skin - r) * min(max(share, 0.0), 1.0)
    return faded


@compiled(inline="always")
def around(theta: float, limits: GridLimits) -> float:
    """Angle in [0, 2π) from the grid's first one, theta likewise (compiled) [rad]."""
    u = theta - limits.theta_0
    return u + TURN if u < 0.0 else u


@compiled(inline="always")
def spoke_place(theta: float, limits: GridLimits) -> float:
    """Position of an angle among the spokes, 0 at the first (compiled).

    Clamped to the outermost spokes of a sector, where there is no flux.
    """
    place = around(theta, limits) * limits.per_theta - limits.shift
    kept: float = min(max(place, 0.0), limits.last_cell + 1.0)
    return kept
