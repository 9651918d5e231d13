"""Covariance of the errors of rendered wrenches, and their rows over a field.

A rendered wrench differs from the true one by the error of the field and by what no
field has right at a place (`wrench_noise`); a measured wrench by the noise of its frame
as well.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from ttus_opt.contact.contact_size import patches_of, size_slopes
from ttus_opt.contact.friction import (
    DRAG_AT_POINTS,
    DRAG_AT_REFERENCE,
    DRAG_AXIS,
    DRAG_DEADBAND,
    FRICTION,
    Sliding,
    coulomb_rows,
)
from ttus_opt.contact.point_drag import point_drag_rows
from ttus_opt.contact.rows import contact_rows
from ttus_opt.core.arrays import Array, Mask
from ttus_opt.fitting.uncertainty.wrench_noise import WrenchNoise
from ttus_opt.haptic.drag import DragLaw
from ttus_opt.haptic.presliding import with_bristle
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.sampling import least_length


@dataclass(frozen=True)
class WrenchUncertainty:
    """Covariance of the errors of rendered wrenches, and of the measurement noise.

    Attributes:
        covariance: Error of rendered force [N] and torque [N·m] in every frame against
            the true ones, shape (T, 6, 6); NaN where it is unknown.
        noise: Further error of measured wrenches, shape (T, 6, 6); NaN for torque where
            none was measured.
    """

    covariance: Array = field(repr=False)
    noise: Array = field(repr=False)

    @classmethod
    def of(
        cls,
        potential: PotentialField,
        shell: PointShell,
        trajectory: Trajectory,
        covariance: Callable[[sp.csr_array, int, Array], Array],
        noise: WrenchNoise,
    ) -> WrenchUncertainty:
        """The uncertainty along a trajectory.

        Args:
            potential: The field.
            shell: The probe.
            trajectory: Poses; with drag, their motion matters.
            covariance: As `Uncertainty.covariance`.
            noise: Noise of measured wrenches.
        """
        rows = wrench_rows(potential, shell, trajectory)
        wrench = rendered(potential, rows)
        sized = slopes_along(potential, shell, trajectory)[:, None] * wrench
        error = covariance(rows, 6, sized.ravel()) + noise.of_model(wrench)
        return cls(error, noise.of_frame(wrench))

    @property
    def known(self) -> Mask:
        """Frames in which the covariance is known, shape (T,)."""
        return np.asarray(np.isfinite(self.covariance[:, 0, 0]))

    @property
    def force(self) -> Array:
        """Standard deviation of the force's components, shape (T, 3) [N]."""
        return _deviations(self.covariance)[:, :3]

    @property
    def torque(self) -> Array:
        """Standard deviation of the torque's components, shape (T, 3) [N·m]."""
        return _deviations(self.covariance)[:, 3:]

    @property
    def force_noise(self) -> Array:
        """Standard deviation of the noise of force components, shape (T, 3) [N]."""
        return _deviations(self.noise)[:, :3]

    @property
    def torque_noise(self) -> Array:
        """The same for torque; NaN where none was measured [N·m]."""
        return _deviations(self.noise)[:, 3:]

    @property
    def force_size(self) -> Array:
        """Standard deviation of the whole force, √ trace, shape (T,) [N]."""
        return np.asarray(np.sqrt((self.force**2).sum(axis=1)))

    @property
    def torque_size(self) -> Array:
        """Standard deviation of the whole torque, √ trace, shape (T,) [N·m]."""
        return np.asarray(np.sqrt((self.torque**2).sum(axis=1)))


def wrench_rows(
    potential: PotentialField, shell: PointShell, trajectory: Trajectory
) -> sp.csr_array:
    """Force and torque rows of every frame, six of a frame together, (6T, V).

    Args:
        potential: The field, with drag among its parameters.
        shell: The probe.
        trajectory: Poses; with drag, their motion matters.
    """
    voxmap, parameters = potential.voxmap, potential.parameters
    poses = trajectory.rotation, trajectory.position
    rows = contact_rows(voxmap, shell, *poses, sampling=potential.sampling)
    N, W = rows.N, rows.W
    mu = parameters.get(FRICTION, 0.0)
    if mu:
        where, deadband = (voxmap, shell, trajectory), parameters[DRAG_DEADBAND]
        if parameters.get(DRAG_AT_POINTS):
            drag = point_drag_rows(
                *where, sampling=potential.sampling, deadband=deadband
            )
        else:
            at = "reference" if parameters.get(DRAG_AT_REFERENCE) else "contact"
            axis = np.array([parameters[name] for name in DRAG_AXIS])
            sliding = Sliding.of(*where, at, axis, rows.patches)
            law = DragLaw.of(parameters, voxmap.grid)
            force = (N @ potential.values.reshape(-1)).reshape(-1, 3)
            sliding = with_bristle(sliding, law.numbers, shell, trajectory, force)
            drag = coulomb_rows(sliding, rows, deadband=deadband)
        N, W = N - mu * drag.force, W - mu * drag.torque
    both = sp.csr_array(sp.vstack([N, W], format="csr"))
    order = np.arange(both.shape[0]).reshape(2, -1, 3).transpose(1, 0, 2)
    return sp.csr_array(both[order.ravel()])


def slopes_along(
    potential: PotentialField, shell: PointShell, trajectory: Trajectory
) -> Array:
    """Relative change of every frame's wrench per ln ℓ₀ of `contact-size`, (T,) [–]."""
    poses = trajectory.rotation, trajectory.position
    spread = patches_of(potential.voxmap, shell, *poses).spread
    return size_slopes(spread, least_length(potential.sampling))


def rendered(potential: PotentialField, rows: sp.csr_array) -> Array:
    """Force [N] and torque [N·m] of every frame by `wrench_rows`, shape (T, 6)."""
    return np.asarray(rows @ potential.values.reshape(-1)).reshape(-1, 6)


def _deviations(covariance: Array) -> Array:
    """Square roots of the diagonals, shape (T, 6)."""
    return np.asarray(np.sqrt(np.einsum("tii->ti", covariance)))
