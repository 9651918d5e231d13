"""Penetration of a probe into the patient: the geometry that comparators share.

Here the surface r = R(θ, z) is a cubic spline through its nodes, periodic in θ and
constant beyond both ends, so that normals are continuous. The depth of a point x is the
signed distance to it, found by iterating for the foot point c with the outward normal
n = ∇F/|∇F|, F = r − R(θ, z):

    depth = −n·(x − c) − F(c)/|∇F(c)|,   c ← x + depth n,

a fixed number of times, so that depth and normal are continuous in x. One step reduces
the error by about depth times the difference of curvatures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.compiled import compiled
from ttus_opt.probe.cylindrical import turn_angle
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.scan.radius_lookup import RadiusLayout, radius_between, radius_cell
from ttus_opt.scan.surface import Surface

#: Iterations for the foot point; the distance is then exact to 0.01 mm on a torso
STEPS = 4

#: Angles repeated on both sides of the seam, for a periodic spline: what its ends
#: assume decreases by 3.7 per node
WRAP = 24

#: Nodes of the spline's table per node of the surface, in each direction [–]
FINER = 4

#: Lower limit of radii: the axis has no angle [m]
LEAST_RADIUS = 0.005


class SmoothSurface:
    """A surface as a spline, with its signed distance."""

    def __init__(self, surface: Surface) -> None:
        from scipy.interpolate import RectBivariateSpline

        self.surface = surface
        n, n_z = len(surface.theta), len(surface.z)
        turn = np.arange(-WRAP, n + WRAP)
        step = 2.0 * np.pi / n
        spline = RectBivariateSpline(
            surface.theta[0] + turn * step,
            surface.z,
            surface.radius[turn % n],
            kx=3,
            ky=min(3, n_z - 1),
        )
        # R, R_θ and R_z on nodes fine enough for linear interpolation
        theta = surface.theta[0] + np.arange(n * FINER) * (step / FINER)
        z = np.linspace(surface.z[0], surface.z[-1], (n_z - 1) * FINER + 1)
        parts = [spline(theta, z), spline(theta, z, dx=1), spline(theta, z, dy=1)]
        self._tables = np.stack([part.reshape(-1) for part in parts])
        self._nodes = len(theta), len(z)
        layout = surface.kernel_layout
        per_z = float((len(z) - 1) / (z[-1] - z[0]))
        self._layout = layout._replace(per_theta=FINER * layout.per_theta, per_z=per_z)

    def depth(self, points: Array) -> tuple[Array, Array]:
        """Depth below the surface and the outward normal at the foot point.

        Args:
            points: Patient frame, shape (n, 3) [m].

        Returns:
            Depths, positive inside, shape (n,) [m]; unit normals, shape (n, 3) [–].
        """
        depth, normals = np.empty(len(points)), np.empty((len(points), 3))
        given = np.ascontiguousarray(points), self._tables, self._nodes, self._layout
        _walk(*given, depth, normals)
        return depth, normals


@compiled()
def _walk(
    points: Array,
    tables: Array,
    nodes: tuple[int, int],
    layout: RadiusLayout,
    depth: Array,
    normals: Array,
) -> None:
    """Depths and normals of points (compiled)."""
    n, n_z = nodes
    z_high = layout.z_0 + (n_z - 1) / layout.per_z
    for m in range(len(points)):
        x, y, z = points[m]
        for _ in range(STEPS):
            here, after, a, b = radius_cell(turn_angle(x, y), z, n, n_z, layout)
            r, radius = math.hypot(x, y), radius_between(here, after, a, b, tables[0])
            across = max(r, LEAST_RADIUS)
            around = radius_between(here, after, a, b, tables[1]) / across
            g0, g1 = (x + y * around) / across, (y - x * around) / across
            # constant beyond the ends
            within = layout.z_0 <= z <= z_high
            g2 = -radius_between(here, after, a, b, tables[2]) if within else 0.0
            steep = math.sqrt(g0 * g0 + g1 * g1 + g2 * g2)
            g0, g1, g2 = g0 / steep, g1 / steep, g2 / steep
            x0, y0, z0 = points[m]
            d = -((x0 - x) * g0 + (y0 - y) * g1 + (z0 - z) * g2)
            d -= (r - radius) / steep
            x, y, z = x0 + d * g0, y0 + d * g1, z0 + d * g2
        depth[m] = d
        normals[m, 0], normals[m, 1], normals[m, 2] = g0, g1, g2


@dataclass(frozen=True)
class Touch:
    """Shell points in contact in one pose, patient axes.

    Attributes:
        index: Numbers of the shell's points, shape (k,).
        arm: Vectors from the shell's reference to the points, shape (k, 3) [m].
        depth: Below the surface, shape (k,) [m].
        inward: The probe's normals, into the probe, shape (k, 3) [–].
        areas: Shape (k,) [m²].
        reference: The shell's reference point, shape (3,) [m].
    """

    index: IntArray = field(repr=False)
    arm: Array = field(repr=False)
    depth: Array = field(repr=False)
    inward: Array = field(repr=False)
    areas: Array = field(repr=False)
    reference: Array

    def __len__(self) -> int:
        """Points in contact [–]."""
        return len(self.index)

    def pushed(self, pressure: Array) -> Array:
        """Wrench of a pressure on the probe along its normals.

        Args:
            pressure: Per point, shape (k,) [N/m²].

        Returns:
            Force and torque about the reference, shape (6,) [N, N·m].
        """
        forces = (pressure * self.areas)[:, None] * self.inward
        return wrench_of(forces, self.arm)

    @cached_property
    def patch(self) -> Patch:
        """The contact patch."""
        return Patch.of(self)


@dataclass(frozen=True)
class Patch:
    """A contact patch; all values are continuous in the pose, and zero without contact.

    Attributes:
        depth: Depth of the deepest point [m].
        area: (Σ a d)²/Σ a d², the area for uniform depth [m²].
        unit: Wrench on the probe for a normal force of 1 N, shape (6,) [–, m].
        centre: Contact point, averaged by depth, patient frame, shape (3,) [m].
        arm: Vector from the shell's reference to the centre [m].
    """

    depth: float
    area: float
    unit: Array
    centre: Array
    arm: Array

    @classmethod
    def of(cls, touch: Touch) -> Patch:
        """The patch of the points in contact."""
        if not len(touch):
            nothing = np.zeros(3)
            return cls(0.0, 0.0, np.zeros(6), nothing, nothing)
        share = touch.areas * touch.depth
        whole = touch.pushed(touch.depth)
        size = float(np.linalg.norm(whole[:3]))
        arm = share @ touch.arm / share.sum()
        return cls(
            float(touch.depth.max()),
            float(share.sum() ** 2 / (share @ touch.depth)),
            whole / size if size > 0.0 else np.zeros(6),
            touch.reference + arm,
            arm,
        )

    @property
    def direction(self) -> Array:
        """Direction of the normal force, shape (3,) [–]."""
        return np.asarray(self.unit[:3])

    def velocity(self, twist: Array, reference: Array, at: Array) -> Array:
        """Velocity of the probe at the patch's centre, shape (3,) [m/s].

        Args:
            twist: Twist of the probe frame's origin, shape (6,) [m/s, rad/s].
            reference: The shell's reference point, patient frame [m].
            at: The probe frame's origin [m].
        """
        return np.asarray(twist[:3] + np.cross(twist[3:], reference + self.arm - at))


class ContactGeometry:
    """A probe and a patient's surface, with their contact in any pose."""

    def __init__(self, surface: Surface, shell: PointShell) -> None:
        self.surface, self.shell = SmoothSurface(surface), shell
        self._reach = float(surface.radius.max())

    def touch(self, R: Array, at: Array) -> Touch:
        """Points below the surface.

        Args:
            R: Probe to patient, shape (3, 3) [–].
            at: The probe frame's origin, patient frame, shape (3,) [m].
        """
        reference = R @ self.shell.reference + at
        arm = (self.shell.points - self.shell.reference) @ R.T
        points = reference + arm
        # exact distances are only needed near and below the surface
        near = np.zeros(0, np.int64)
        if np.hypot(points[:, 0], points[:, 1]).min() <= self._reach:
            near = np.flatnonzero(self.surface.surface.depth_of(points) > -0.005)
        depth, _ = self.surface.depth(points[near])
        inside = depth > 0.0
        index = near[inside]
        return Touch(
            index,
            arm[index],
            depth[inside],
            self.shell.normals[index] @ R.T,
            self.shell.areas[index],
            reference,
        )


def wrench_of(forces: Array, arms: Array) -> Array:
    """Sum of forces (k, 3) [N] and of their torques about the arms' origin, (6,)."""
    return np.concatenate([forces.sum(axis=0), np.cross(arms, forces).sum(axis=0)])
