"""Force rows as functions of the poses, and their derivatives."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from ttus_opt.arrays import Array
from ttus_opt.contact.friction import DEADBAND
from ttus_opt.contact.rows import contact_rows
from ttus_opt.contact.slip import Slip
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.tracker_noise import TrackerNoise
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.voxmap.voxmap import Voxmap


@dataclass(frozen=True)
class PoseRows:
    """Rows N − μ F of contact with drag at every shell point.

    Attributes:
        voxmap: Grid and surface.
        shell: The probe.
        sampling: Of the field.
        friction: μ [–].
        twist: Motion of the shell's reference, which the errors of poses do not change,
            shape (T, 6) [m/s, rad/s].
    """

    voxmap: Voxmap
    shell: PointShell = field(repr=False)
    sampling: str
    friction: float
    twist: Array = field(repr=False)

    @classmethod
    def of(
        cls,
        voxmap: Voxmap,
        shell: PointShell,
        trajectory: Trajectory,
        sampling: str,
        friction: float,
    ) -> PoseRows:
        """With the motion of a recording; arguments as the attributes."""
        twist = trajectory.twist()  # of the frame's origin; from there to the reference
        reference = np.einsum("tij,j->ti", trajectory.rotation, shell.reference)
        twist[:, :3] += np.cross(twist[:, 3:], reference)
        return cls(voxmap, shell, sampling, friction, twist)

    def at(self, rotation: Array, position: Array) -> sp.csr_array:
        """The rows at poses (T, 3, 3) and (T, 3), shape (3T, V)."""
        at = self.voxmap, self.shell, rotation, position
        pressed = contact_rows(*at, sampling=self.sampling).N
        if self.friction == 0.0:
            return pressed
        slip = Slip(self.twist, DEADBAND)
        dragged = contact_rows(*at, sampling=self.sampling, slip=slip).N
        return sp.csr_array(pressed - self.friction * dragged)

    def derivatives(
        self, rotation: Array, position: Array, noise: TrackerNoise
    ) -> list[sp.csr_array]:
        """Change of the rows per component of ξ, by central differences of one σ.

        A step as wide as the errors smooths the corners of the interpolation, as the
        errors themselves do.
        """
        found = []
        for unit in np.eye(6):
            ahead = self.at(*noise.moved(rotation, position, unit))
            behind = self.at(*noise.moved(rotation, position, -unit))
            found.append(sp.csr_array(0.5 * (ahead - behind)))
        return found
