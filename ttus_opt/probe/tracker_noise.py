"""Errors of tracked poses: how large, and how long they stay alike.

The error of a reported pose is a shift and a rotation about the patient's axes,

    x_reported = x + σ_x ξ_x,   R_reported = exp(σ_R [ξ_R]×) R,

with ξ, of shape (T, 6), a stationary Gauss–Markov process of unit variance: errors at t
and t' of one recording have the correlation exp(−|t − t'|/T_c), those of two recordings
and of two axes none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import InputError
from ttus_opt.probe.trajectory import Trajectory

#: Largest standard deviations: larger errors are no noise [m], [rad]
LARGEST_POSITION, LARGEST_ROTATION = 0.01, math.radians(10.0)


@dataclass(frozen=True)
class TrackerNoise:
    """Noise of a tracker.

    Attributes:
        position: Standard deviation of a position, per axis [m].
        rotation: Standard deviation of a rotation, per axis [rad].
        correlation: Correlation time T_c [s]; 0 for errors that are new in every frame.
    """

    position: float = 0.5e-3
    rotation: float = math.radians(0.5)
    correlation: float = 1.0

    def __post_init__(self) -> None:
        """Validate.

        Raises:
            InputError: A number that is not finite, negative, or too large for noise.
        """
        if not 0.0 < self.position <= LARGEST_POSITION:
            raise InputError(
                "the tracker's position noise must be above 0 and at most "
                f"{1e3 * LARGEST_POSITION:g} mm, got {1e3 * self.position:g} mm: it is "
                "given in metres"
            )
        if not 0.0 < self.rotation <= LARGEST_ROTATION:
            raise InputError(
                "the tracker's rotation noise must be above 0 and at most "
                f"{math.degrees(LARGEST_ROTATION):g}°, got "
                f"{math.degrees(self.rotation):g}°: it is given in radians"
            )
        if not 0.0 <= self.correlation < math.inf:
            raise InputError(
                "the tracker's correlation time must be finite and not negative, got "
                f"{self.correlation:g} s"
            )

    @property
    def sizes(self) -> Array:
        """Standard deviations by component of ξ, shape (6,) [m, rad]."""
        return np.repeat([self.position, self.rotation], 3)

    def moved(self, rotation: Array, position: Array, xi: Array) -> tuple[Array, Array]:
        """Poses with errors.

        Args:
            rotation: Shape (T, 3, 3) [–].
            position: Shape (T, 3) [m].
            xi: Errors ξ, shape (T, 6) or (6,) for all poses [–].
        """
        xi = np.broadcast_to(xi, (len(position), 6))
        turn = Rotation.from_rotvec(self.rotation * xi[:, 3:]).as_matrix()
        return turn @ rotation, position + self.position * xi[:, :3]

    def without(self, trajectory: Trajectory, xi: Array) -> Trajectory:
        """A recording with errors ξ, shape (T, 6), taken off its poses."""
        rotation, position = self.moved(trajectory.rotation, trajectory.position, -xi)
        return replace(trajectory, rotation=rotation, position=position)

    def correlations(self, trajectory: Trajectory, frames: IntArray) -> Array:
        """Correlation of ξ in all frames with ξ in some.

        Args:
            trajectory: Times and recordings.
            frames: Which frames, shape (k,).

        Returns:
            Shape (T, k) [–].
        """
        time, segment = trajectory.time, trajectory.segment
        apart = np.abs(time[:, None] - time[frames])
        if self.correlation > 0.0:
            alike = np.exp(-apart / self.correlation)
        else:
            alike = (apart == 0.0).astype(np.float64)
        return np.asarray(np.where(segment[:, None] == segment[frames], alike, 0.0))
