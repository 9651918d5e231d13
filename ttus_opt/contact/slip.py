"""In which direction a shell point slides, for rows of drag point by point."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.compiled import compiled
from ttus_opt.probe.point_shell import PointShell


class Slip(NamedTuple):
    """How the shell's points slide, for rows of drag in place of those of contact.

    Attributes:
        twist: Velocity of the shell's reference and angular velocity, patient axes,
            shape (T, 6) [m/s, rad/s]; (0, 6) for rows of contact.
        deadband: A point that slides slower drags in proportion [m/s].
    """

    twist: Array
    deadband: float

    @classmethod
    def of(
        cls, shell: PointShell, rotation: Array, twist: Array, deadband: float
    ) -> Slip:
        """From the velocity of the probe frame's origin.

        Args:
            shell: The probe.
            rotation: Probe to patient, shape (T, 3, 3) [–].
            twist: Velocity of that origin and angular velocity, patient axes, shape
                (T, 6) [m/s, rad/s].
            deadband: Speed below which drag decreases in proportion [m/s].
        """
        reference = np.einsum("tij,j->ti", rotation, shell.reference)
        moved = np.array(twist, dtype=np.float64)
        moved[:, :3] += np.cross(moved[:, 3:], reference)
        return cls(moved, float(deadband))

    @classmethod
    def none(cls) -> Slip:
        """Rows of contact."""
        return cls(np.empty((0, 6)), 1.0)


@compiled(inline="always")
def slipping(
    n: tuple[float, float, float],
    lever: tuple[float, float, float],
    twist: tuple[float, float, float, float, float, float],
    deadband: float,
) -> tuple[float, float, float]:
    """Direction in which a point slides, shorter than 1 below the deadband (compiled).

    Args:
        n: Its unit normal.
        lever: From the shell's reference to it [m].
        twist: Velocity of the reference [m/s] and angular velocity [rad/s], all in
            the same axes.
        deadband: v₀ [m/s].
    """
    vx, vy, vz, wx, wy, wz = twist
    ux = vx + (wy * lever[2] - wz * lever[1])
    uy = vy + (wz * lever[0] - wx * lever[2])
    uz = vz + (wx * lever[1] - wy * lever[0])
    along = n[0] * ux + n[1] * uy + n[2] * uz
    ux, uy, uz = ux - along * n[0], uy - along * n[1], uz - along * n[2]
    k = 1.0 / max(math.sqrt(ux * ux + uy * uy + uz * uz), deadband)
    return k * ux, k * uy, k * uz
