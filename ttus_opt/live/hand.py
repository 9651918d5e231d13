"""A simulated hand: it wants to be somewhere, and force pushes it away.

Arm and device are a mass on a spring and a damper whose other end follows the intended
motion. Values of a hand that holds a stylus: 0.1 to 1 kN/m, 5 to 20 N·s/m (K. J.
Kuchenbecker, J. G. Park, G. Niemeyer, IMECE 2003-42600; T. L. Gibo, A. J. Bastian, A.
M. Okamura, IEEE World Haptics 2013).
"""

from __future__ import annotations

import math
from bisect import bisect_right

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.probe.trajectory import Trajectory

#: Farthest that a device's handle gets from where the hand wants it [m]
REACH = 0.05

#: Time between changes of the rotation [s]
TURNS = 5e-3

#: Mass [kg], stiffness [N/m] and damping [N·s/m] of hand and device
MASS, STIFFNESS, DAMPING = 0.4, 500.0, 15.0


class Hand:
    """A hand that follows a path of the probe and yields to force.

    Attributes:
        position: Of the probe in the hand, patient frame, shape (3,) [m].
        rotation: Probe to patient, shape (3, 3) [–].
        velocity: Shape (3,) [m/s].
    """

    def __init__(self, path: Trajectory, *, again: float = math.inf) -> None:
        """A hand at the start of a path.

        Args:
            path: What it intends.
            again: Time from the start to which it returns at the path's end [s]; by
                default it stays there.
        """
        self._path = path
        self._again, self._ends = again, float(path.time[-1] - path.time[0])
        self.position, self.velocity = path.position[0].copy(), np.zeros(3)
        self.rotation = path.rotation[0].copy()
        # lists and constants: this runs a thousand times a second
        self._times = (path.time - path.time[0]).tolist()
        self._ways = np.diff(path.position, axis=0)
        self._speeds = self._ways / np.diff(path.time)[:, None]
        self._turned = -np.inf

    def step(self, time: float, wrench: Array, seconds: float) -> None:
        """Move for some seconds under a force; see `real_time.HandDevice`."""
        wanted, speed = self.wanted(time)
        pull = STIFFNESS * (wanted - self.position)
        pull += DAMPING * (speed - self.velocity) + wrench[:3]
        self.velocity = self.velocity + seconds / MASS * pull
        self.position = self.position + seconds * self.velocity
        away = self.position - wanted
        length = math.sqrt(away @ away)
        if length > REACH:  # the end of the device's workspace
            self.position = wanted + away * (REACH / length)
            self.velocity = speed.copy()

    def wanted(self, time: float) -> tuple[Array, Array]:
        """Intended position and velocity; the hand turns as it intends."""
        path, times, at = self._path, self._times, self._within(time)
        k = min(max(bisect_right(times, at) - 1, 0), len(times) - 2)
        share = min(max((at - times[k]) / (times[k + 1] - times[k]), 0.0), 1.0)
        if time - self._turned >= TURNS:
            mean = (1.0 - share) * path.rotation[k] + share * path.rotation[k + 1]
            u, _, vt = np.linalg.svd(mean)  # the nearest rotation
            self.rotation, self._turned = u @ vt, time
        return path.position[k] + share * self._ways[k], self._speeds[k]

    def _within(self, time: float) -> float:
        """Time on the path [s]."""
        if time < self._ends or self._again >= self._ends:
            return time
        return self._again + (time - self._again) % (self._ends - self._again)
