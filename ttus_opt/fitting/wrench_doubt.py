"""The covariance of rendered wrenches, and the rows that they are of a field."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from ttus_opt.arrays import Array, Mask
from ttus_opt.contact.friction import (
    DRAG_AT_REFERENCE,
    DRAG_AXIS,
    DRAG_DEADBAND,
    FRICTION,
    Sliding,
    coulomb_rows,
)
from ttus_opt.contact.rows import contact_rows
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.voxmap.voxmap import Voxmap


@dataclass(frozen=True)
class WrenchDoubt:
    """Posterior covariance of rendered wrenches.

    Attributes:
        covariance: Of force [N] and torque [N·m] of every frame, shape (T, 6, 6); NaN
            where it is not known.
        force_noise: Standard deviation of what a measured force component shows beside
            the field [N].
        torque_noise: The same of a torque component; NaN without [N·m].
    """

    covariance: Array = field(repr=False)
    force_noise: float
    torque_noise: float

    @property
    def known(self) -> Mask:
        """Whether it is known in a frame, shape (T,)."""
        return np.asarray(np.isfinite(self.covariance[:, 0, 0]))

    @property
    def force(self) -> Array:
        """Standard deviation of the force's components, shape (T, 3) [N]."""
        return np.asarray(np.sqrt(np.einsum("tii->ti", self.covariance)[:, :3]))

    @property
    def torque(self) -> Array:
        """Standard deviation of the torque's components, shape (T, 3) [N·m]."""
        return np.asarray(np.sqrt(np.einsum("tii->ti", self.covariance)[:, 3:]))

    @property
    def force_size(self) -> Array:
        """Standard deviation of the whole force, √ trace, shape (T,) [N]."""
        return np.asarray(np.sqrt((self.force**2).sum(axis=1)))

    @property
    def torque_size(self) -> Array:
        """Standard deviation of the whole torque, √ trace, shape (T,) [N·m]."""
        return np.asarray(np.sqrt((self.torque**2).sum(axis=1)))


def wrench_rows(
    voxmap: Voxmap,
    shell: PointShell,
    sampling: str,
    trajectory: Trajectory,
    parameters: Mapping[str, float],
) -> sp.csr_array:
    """Force and torque rows of every frame, six of a frame together, (6T, V).

    Args:
        voxmap: Grid and surface.
        shell: The probe.
        sampling: Of the field.
        trajectory: Poses; with drag their motion counts.
        parameters: Of the field, its drag among them.
    """
    poses = trajectory.rotation, trajectory.position
    rows = contact_rows(voxmap, shell, *poses, sampling=sampling)
    N, W = rows.N, rows.W
    mu = parameters.get(FRICTION, 0.0)
    if mu:
        at = "reference" if parameters.get(DRAG_AT_REFERENCE) else "contact"
        axis = np.array([parameters[name] for name in DRAG_AXIS])
        sliding = Sliding.of(voxmap, shell, trajectory, at, axis)
        drag = coulomb_rows(sliding, rows, deadband=parameters[DRAG_DEADBAND])
        N, W = N - mu * drag.force, W - mu * drag.torque
    both = sp.csr_array(sp.vstack([N, W], format="csr"))
    T = len(trajectory)
    frame, part = np.divmod(np.arange(6 * T), 6)
    order = np.where(part < 3, 3 * frame + part, 3 * T + 3 * frame + part - 3)
    return sp.csr_array(both[order])
