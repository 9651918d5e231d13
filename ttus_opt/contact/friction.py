"""Drag, the friction force on a sliding probe, as rows linear in the field.

The contact patch of a pose has a normal n̂ (into the probe), a centre and a sliding
velocity v_t, which depend on geometry and motion only. The drag is

    Coulomb   −μ t̂ (n̂ᵀ N p),  t̂ = v_t / max(‖v_t‖, v₀)
    viscous   −c v_t

n̂ᵀ N p is the normal force, so for a given μ drag is linear in p, and a field q in place
of μ p gives −t̂ (n̂ᵀ N q). n̂ and the centre are means over the shell points inside the
patient, weighted by area and depth, because pressure grows with depth. v₀ is the
deadband: below it drag decreases in proportion, and at rest there is none.

Drag acts at one of three places:

- ``contact``: on the patch and along it, with a lever arm about the shell's reference
  point; the rotation of the probe adds to the sliding velocity;
- ``reference``: at the reference point, as in a tool frame, and perpendicular to the
  probe's pressing axis, its axis of symmetry nearest to the mean of n̂. The mean itself
  leans with the tilt of the probe, and with a lean of half a degree a plunge of 10 mm/s
  counts as sliding at 0.1 mm/s, which near rest turns t̂ by several degrees;
- ``points``: at every point of the shell (`ttus_opt.contact.point_drag`); viscous drag
  is then that of the patch.

See docs/method/friction.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.contact.contact_size import Patches, patches_of
from ttus_opt.contact.rows import (
    ContactRows,
    checked_poses,
    diagonal_blocks,
    scaled_rows,
)
from ttus_opt.core.arguments import expect_one_of, expect_positive
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.probe.cylindrical import cylindrical
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.voxmap.voxmap import Voxmap

ActsAt = Literal["contact", "reference", "points"]

#: Relative difference below which principal moments of a shell count as equal [–]
EQUAL_MOMENTS = 0.05

#: Deadband v₀: noise of 0.1 mm between poses 50 ms apart looks like this speed [m/s]
DEADBAND = 2e-3


@dataclass(frozen=True)
class Sliding:
    """Contact patch and sliding velocity of every pose of a trajectory.

    Attributes:
        normal: Mean unit normal of the patch, into the probe, patient axes; zero
            without contact; shape (T, 3) [–].
        arm: From the shell's reference point to the point where drag acts, patient
            axes; shape (T, 3) [m].
        velocity: Velocity of the probe at that point, along the patch or perpendicular
            to the pressing axis; zero without contact; shape (T, 3) [m/s].
        position: Centre of the patch, patient frame, shape (T, 3) [m].
        axis: The pressing axis in the probe frame, unit length; zero without any
            contact; shape (3,) [–].
        acts_at: ``contact``, ``reference`` or ``points``; with ``points``, the other
            attributes are those of ``contact``.
        bristle: Deflection of a bristle (`ttus_opt.haptic.presliding`), the direction
            of drag in its place, shape (T, 3) [–]; None without presliding.
    """

    normal: Array = field(repr=False)
    arm: Array = field(repr=False)
    velocity: Array = field(repr=False)
    position: Array = field(repr=False)
    axis: Array = field(repr=False)
    acts_at: ActsAt = "contact"
    bristle: Array | None = field(default=None, repr=False)

    @classmethod
    def of(
        cls,
        voxmap: Voxmap,
        shell: PointShell,
        trajectory: Trajectory,
        acts_at: str = "contact",
        axis: Array | None = None,
        patches: Patches | None = None,
    ) -> Sliding:
        """Find the patch of every pose and its sliding velocity.

        Args:
            voxmap: Grid and surface.
            shell: The probe.
            trajectory: Poses over time, which give the velocity.
            acts_at: Where drag acts, ``contact``, ``reference`` or ``points``.
            axis: The pressing axis in the probe frame, shape (3,); by default
                `pressing_axis`.
            patches: Those of the trajectory, where they are known.

        Raises:
            InputError: Unknown ``acts_at``, or unusable poses.
        """
        expect_one_of(acts_at, get_args(ActsAt), "acts_at")
        rotation, position = checked_poses(trajectory.rotation, trajectory.position)
        known = patches or patches_of(voxmap, shell, rotation, position)
        normal, centre = known.normal, known.centre
        touching = (normal != 0.0).any(axis=1)
        reference = np.einsum("tij,j->ti", rotation, shell.reference)
        as_tool = acts_at == "reference"
        arm = np.zeros_like(centre) if as_tool else centre
        twist = trajectory.twist()
        moved = twist[:, :3] + np.cross(twist[:, 3:], reference + arm)
        moved[~touching] = 0.0
        if axis is None:
            axis = pressing_axis(shell, np.einsum("tij,ti->j", rotation, normal))
        across = rotation @ axis if as_tool else normal
        along = moved - across * np.einsum("ti,ti->t", across, moved)[:, None]
        where = position + reference + centre
        return cls(normal, arm, along, where, axis, acts_at)  # type: ignore[arg-type]

    def direction(self, deadband: float = DEADBAND) -> Array:
        """t̂, the direction of sliding, short below the deadband; or the bristle.

        Args:
            deadband: v₀ [m/s].

        Returns:
            Shape (T, 3) [–].

        Raises:
            InputError: The deadband is not positive.
        """
        expect_positive(deadband, "deadband", "m/s")
        if self.bristle is not None:
            return self.bristle
        speed = np.linalg.norm(self.velocity, axis=1, keepdims=True)
        return np.asarray(self.velocity / np.maximum(speed, deadband))

    def regions(self, n_theta: int, n_z: int, voxmap: Voxmap) -> NDArray[np.int64]:
        """Which of n_theta × n_z regions of the torso each contact lies on.

        Args:
            n_theta: Sectors around the axis [–].
            n_z: Bands along it [–].
            voxmap: Gives the length along the axis.

        Returns:
            Shape (T,), from 0 to n_theta·n_z − 1.

        Raises:
            InputError: A count below 1, or more than `MOST_REGIONS` regions.
        """
        if n_theta < 1 or n_z < 1:
            raise InputError(
                f"regions need at least one sector and one band, got {n_theta}×{n_z}"
            )
        if n_theta * n_z > MOST_REGIONS:
            raise InputError(
                f"expected at most {MOST_REGIONS:,} regions, got {n_theta}×{n_z}: "
                "choose fewer sectors or bands"
            )
        grid = voxmap.grid
        _, theta, z = cylindrical(self.position)
        sector = (theta * n_theta / (2.0 * np.pi)).astype(np.int64)
        share = (z - grid.z_min) / (grid.z_max - grid.z_min)
        band = np.clip((share * n_z).astype(np.int64), 0, n_z - 1)
        return np.asarray(np.minimum(sector, n_theta - 1) * n_z + band)


def pressing_axis(shell: PointShell, normal: Array) -> Array:
    """The principal axis of a shell nearest to a direction.

    Where principal moments are equal, as for a sphere, the axes span a plane or the
    whole space, and the nearest one is the projection of the direction.

    Args:
        shell: The probe.
        normal: Mean normal of its contacts, probe frame, any length, shape (3,).

    Returns:
        Unit vector in the probe frame, shape (3,); zero for a normal of zero.
    """
    lever = shell.points - shell.reference
    moments, axes = np.linalg.eigh(lever.T @ (shell.areas[:, None] * lever))
    gaps = np.diff(moments) > EQUAL_MOMENTS * moments[1:]
    spaces = np.split(axes.T, np.flatnonzero(gaps) + 1)
    along = max((space.T @ (space @ normal) for space in spaces), key=np.linalg.norm)
    return np.asarray(along / max(float(np.linalg.norm(along)), np.finfo(float).tiny))


@dataclass(frozen=True)
class DragRows:
    """Rows of drag over its n unknowns, a field or coefficients.

    Attributes:
        force: Force rows, shape (3T, n).
        torque: Torque rows about the shell's reference point, shape (3T, n) [m].
    """

    force: sp.csr_array = field(repr=False)
    torque: sp.csr_array = field(repr=False)

    def scaled(self, factor: Array) -> DragRows:
        """The rows of every pose times a factor, shape (T,)."""
        rows = np.repeat(factor, 3)
        return DragRows(scaled_rows(self.force, rows), scaled_rows(self.torque, rows))


def coulomb_rows(
    sliding: Sliding, rows: ContactRows, *, deadband: float = DEADBAND
) -> DragRows:
    """Coulomb drag of a field: F with drag = −F (μ p).

    Args:
        sliding: Patches and sliding velocities of the poses.
        rows: N of the same poses.
        deadband: v₀ [m/s].

    Returns:
        Rows over the voxels, shape (3T, V).
    """
    direction = sliding.direction(deadband)
    turning = np.cross(sliding.arm, direction)
    normal_force = diagonal_blocks(sliding.normal[:, None, :]) @ rows.N  # (T, V)
    return DragRows(
        sp.csr_array(diagonal_blocks(direction[:, :, None]) @ normal_force),
        sp.csr_array(diagonal_blocks(turning[:, :, None]) @ normal_force),
    )


def viscous_rows(
    sliding: Sliding, region: NDArray[np.int64], n_regions: int
) -> DragRows:
    """Viscous drag: columns with drag = −(columns) c.

    Args:
        sliding: Patches and sliding velocities of the poses.
        region: Region whose coefficient acts in each pose, shape (T,).
        n_regions: Number of coefficients [–].

    Returns:
        Rows over the coefficients, shape (3T, n_regions) [m/s].
    """
    turning = np.cross(sliding.arm, sliding.velocity)
    n_poses = len(region)
    columns = np.repeat(region, 3)
    row_ptr = np.arange(3 * n_poses + 1)
    force, torque = (
        sp.csr_array(
            (values.reshape(-1), columns, row_ptr), shape=(3 * n_poses, n_regions)
        )
        for values in (sliding.velocity, turning)
    )
    return DragRows(force, torque)


#: Names of the drag parameters of a fitted field
FRICTION, VISCOUS = "friction_coefficient", "viscous_coefficient"
DRAG_DEADBAND, DRAG_AT_REFERENCE = "drag_deadband", "drag_at_reference"
DRAG_AT_POINTS, PRESLIDING = "drag_at_points", "presliding_length"
DRAG_AXIS = ("drag_axis_x", "drag_axis_y", "drag_axis_z")
SECTORS, BANDS = "viscous_sectors", "viscous_bands"

#: Most regions of the torso with a viscous coefficient each [–]
MOST_REGIONS = 10_000
