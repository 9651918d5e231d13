"""Force rows as functions of the poses, and their derivatives."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from ttus_opt.contact.rows import contact_rows
from ttus_opt.core.arrays import Array
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.tracker_noise import TrackerNoise
from ttus_opt.voxmap.voxmap import Voxmap


@dataclass(frozen=True)
class PoseRows:
    """Rows N of contact without drag.

    Attributes:
        voxmap: Grid and surface.
        shell: The probe.
        sampling: Of the field.
    """

    voxmap: Voxmap
    shell: PointShell = field(repr=False)
    sampling: str

    def at(self, rotation: Array, position: Array) -> sp.csr_array:
        """The rows at poses (T, 3, 3) and (T, 3), shape (3T, V)."""
        at = self.voxmap, self.shell, rotation, position
        return contact_rows(*at, sampling=self.sampling).N

    def derivatives(
        self, rotation: Array, position: Array, noise: TrackerNoise
    ) -> list[sp.csr_array]:
        """Change of the rows per component of ξ, by central differences of one σ.

        A step as wide as the errors smooths the corners of the interpolation, as the
        errors themselves do.
        """
        changes = []
        for unit in np.eye(6):
            ahead = self.at(*noise.moved(rotation, position, unit))
            behind = self.at(*noise.moved(rotation, position, -unit))
            changes.append(sp.csr_array(0.5 * (ahead - behind)))
        return changes
