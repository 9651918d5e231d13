"""From drags to a pose that moves as a hand does.

A browser sends a dragged pose about 20 times a second: rendered as it comes, the force
would step by newtons. The pose therefore follows the dragged one through the two low
passes in series of `ttus_opt.haptic.motion`: a second-order filter without overshoot.
"""

from __future__ import annotations

import math

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.haptic.motion import MOTION, POSE, TWICE, MotionFilter, estimate_twist
from ttus_opt.probe.point_shell import PointShell

#: Time constant of each low pass, one interval between drags; the pose lags by two [s]
SECONDS = 0.05

#: Distance and angle below which the pose has arrived [m], [rad]
ARRIVED, TURNED = 1e-6, 1e-5


class HandMotion:
    """A pose on its way to another.

    Args:
        shell: The probe; what is filtered is the position of its reference point.
        rotation: First pose, probe to patient, shape (3, 3) [–].
        position: Its origin, patient frame, shape (3,) [m].
        seconds: Time constant of each of the two low passes [s].
    """

    def __init__(
        self,
        shell: PointShell,
        rotation: Array,
        position: Array,
        seconds: float = SECONDS,
    ) -> None:
        self._reference = shell.reference
        law = MotionFilter(seconds=seconds, gap=1e9)  # a probe at rest stays known
        self._numbers = law.kernel_numbers(shell.rms_radius)
        self._twist = np.zeros(6)
        self.put(rotation, position)

    def put(self, rotation: Array, position: Array) -> None:
        """Be at a pose at once, at rest."""
        self.rotation, self.position = np.array(rotation), np.array(position)
        self._state, self._time = np.zeros(MOTION), 0.0
        self._see(self.rotation, self.position)

    def step(self, rotation: Array, position: Array, seconds: float) -> bool:
        """Move on towards a pose.

        Args:
            rotation: Where the hand is, shape (3, 3) [–].
            position: Its origin, shape (3,) [m].
            seconds: Time since the last step [s].

        Returns:
            Whether it moved; it rests once it has arrived.
        """
        away = float(np.linalg.norm(position - self.position))
        cosine = 0.5 * (float(np.sum(rotation * self.rotation)) - 1.0)
        turn = math.acos(min(max(cosine, -1.0), 1.0))
        if away == 0.0 and turn < TURNED:
            return False
        if away < ARRIVED and turn < TURNED:
            self.put(rotation, position)
            return True
        self._time += seconds
        self._see(rotation, position)
        at = self._state[TWICE : TWICE + POSE]
        self.rotation = at[3:].reshape(3, 3).copy()
        self.position = at[:3] - self.rotation @ self._reference
        return True

    def _see(self, rotation: Array, position: Array) -> None:
        estimate_twist(
            self._state,
            np.ascontiguousarray(rotation, dtype=np.float64),
            np.ascontiguousarray(position, dtype=np.float64),
            self._time,
            self._reference,
            self._numbers,
            self._twist,
        )
