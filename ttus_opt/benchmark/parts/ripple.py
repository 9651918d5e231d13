"""Part ``ripple``: discretisation ripple of the force in a slide.

A probe slides at constant depth on a cylinder whose field depends on depth alone. The
force should be constant; its variation, peak to peak over mean, is due to the voxels.
The cylinder is offset from the grid's axis and tilted, because otherwise layers would
be parallel to the surface and trilinear values exact. Surface and field have the same
step. Pressure-field contact has 0.07 % with fine meshes and 6.5 % with coarse ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.machine import Progress
from ttus_opt.benchmark.parts.base import Column, Part
from ttus_opt.benchmark.row import Row, RunSpec, Settings
from ttus_opt.benchmark.summary import times
from ttus_opt.contact.rows import Sampling
from ttus_opt.core.arrays import Array
from ttus_opt.haptic.renderer import Renderer
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.grid import CylindricalGrid
from ttus_opt.voxmap.voxmap import Voxmap

Direction = Literal["along", "around"]

#: Steps of the grid [m]
VOXELS = (0.001, 0.002, 0.004)

#: The cylinder's radius, and its offset from the grid's axis [m]
RADIUS, OFFSET = 0.1, 0.01

#: Tilt of the cylinder in the direction of its offset [rad]
LEAN = math.radians(10.0)

#: The innermost layer's radius, and half the grid's height [m]
INNER, HALF = 0.06, 0.055

#: Length of the slide, and depth of the probe's tip [m]
SLIDE, DEPTH = 0.012, 0.008

#: Half axes of the probe [m]
SEMI_AXES = (0.030, 0.0125, 0.018)


class RipplePart(Part):
    """Both samplings and directions, one run per voxel size."""

    name = "ripple"
    title = "Ripple of the force in a slide"
    legend = (
        "A probe slides at constant depth where nothing changes, so that the force "
        "should not either: peak to peak over mean of its magnitude. The ratio is to "
        "`voxel-mean` with the same voxels and direction. The slide brings its own "
        "cylinder and takes no case."
    )
    columns = (
        Column("voxel [mm]", "voxel", lambda value: f"{1e3 * value:g}"),
        Column("direction", "direction"),
        Column("sampling", "sampling"),
        Column("ripple [%]", "ripple", lambda value: f"{100.0 * value:.3g}"),
        Column("to voxel-mean", "ratio_to_voxel_mean", times),
    )

    def plan(self, cases: Sequence[CaseSpec], settings: Settings) -> list[RunSpec]:
        """One run per voxel size, independent of the cases."""
        return [
            RunSpec(self.name, None, {"voxel": voxel}, settings.time_limit)
            for voxel in VOXELS
        ]

    def measure(self, spec: RunSpec, begin: Progress) -> list[Row]:
        """Slide in both directions with both samplings."""
        rows: list[Row] = []
        for direction in get_args(Direction):
            found = []
            for sampling in get_args(Sampling):
                begin(f"{sampling} {direction}")
                found.append(ripple(sampling, direction=direction, **spec.options))
            means = next(row for row in found if row["sampling"] == "voxel-mean")
            rows += [
                row | {"ratio_to_voxel_mean": row["ripple"] / means["ripple"]}
                for row in found
            ]
        return rows


def ripple(
    sampling: str,
    voxel: float,
    *,
    direction: Direction = "along",
    n_points: int = 5000,
    n_poses: int = 400,
) -> Row:
    """Slide an ellipsoid over a cylinder.

    Args:
        sampling: ``voxel-mean`` or ``trilinear``.
        voxel: Step of the grid [m].
        direction: ``along`` the cylinder or ``around`` it.
        n_points: Points of the probe's shell.
        n_poses: Poses of the slide.

    Returns:
        The arguments, ``mean_force`` [field's unit times cm², or times voxels] and
        ``ripple``: peak to peak over mean of the force's magnitude [–].
    """
    shell = PointShell.ellipsoid(semi_axes=SEMI_AXES, n_points=n_points)
    renderer = Renderer(cylinder_field(sampling, voxel), shell)
    frame = _cylinder_axes()
    force = np.empty(n_poses)
    for t, way in enumerate(np.linspace(-SLIDE / 2, SLIDE / 2, n_poses)):
        angle = 0.37 + (way / RADIUS if direction == "around" else 0.0)
        z = way if direction == "along" else 0.0
        out = np.array([math.cos(angle), math.sin(angle), 0.0])
        # long axis along the cylinder, third axis towards it
        along = np.array([0.0, 0.0, 1.0])
        rotation = np.stack([along, np.cross(-out, along), -out], axis=1)
        position = (RADIUS + SEMI_AXES[2] - DEPTH) * out + z * along
        wrench = renderer.render(
            frame @ rotation, frame @ position + [OFFSET, 0.0, 0.0]
        )
        force[t] = np.linalg.norm(wrench.force)
    mean = float(force.mean())
    return {
        "voxel": voxel,
        "direction": direction,
        "sampling": sampling,
        "mean_force": mean,
        "ripple": float(np.ptp(force)) / mean,
    }


def _cylinder_axes() -> Array:
    """Rotation from the cylinder's frame to the grid's, shape (3, 3)."""
    s, c = math.sin(LEAN), math.cos(LEAN)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def cylinder_field(sampling: str, voxel: float) -> PotentialField:
    """The harmonic field log(R/d) about a tilted cylinder, R = `RADIUS`.

    Args:
        sampling: ``voxel-mean`` or ``trilinear``.
        voxel: Step in r, z, and in θ at the surface, of surface and field [m].
    """
    n_theta = round(2.0 * math.pi * RADIUS / voxel)
    n_z = math.ceil(2.0 * HALF / voxel) + 1
    z: Array = np.linspace(-HALF, -HALF + (n_z - 1) * voxel, n_z)
    theta: Array = np.linspace(0.0, 2.0 * math.pi, n_theta, endpoint=False)
    radius = _surface_radius(theta[:, None], z)
    n_r = math.ceil((float(radius.max()) + voxel - INNER) / voxel) + 1
    grid = CylindricalGrid(
        INNER,
        INNER + (n_r - 1) * voxel,
        float(z[0]),
        float(z[-1]),
        (n_r, n_theta, n_z),
    )
    r = grid.r[:, None, None]
    x, y = r * np.cos(theta)[:, None] - OFFSET, r * np.sin(theta)[:, None]
    across = x * math.cos(LEAN) - z * math.sin(LEAN)
    values = np.log(RADIUS / np.hypot(across, y))
    region = np.sign(np.round((radius - r) / voxel)).astype(np.int8)
    surface = Surface.from_radius(radius, z)
    return PotentialField(Voxmap(grid, surface, region), values, sampling)


def _surface_radius(theta: Array, z: Array) -> Array:
    """Radius at which a ray from the grid's axis leaves the cylinder [m]."""
    s, c = math.sin(LEAN), math.cos(LEAN)
    # (c (R cos θ − x0) − s z)² + (R sin θ)² = RADIUS², for R
    shift = -c * OFFSET - s * z
    a = (c * np.cos(theta)) ** 2 + np.sin(theta) ** 2
    b = c * np.cos(theta) * shift
    root = np.sqrt(b * b - a * (shift**2 - RADIUS**2))
    return np.asarray((root - b) / a)


PART = RipplePart()
