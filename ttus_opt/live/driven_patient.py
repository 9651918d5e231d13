"""A robot that is driven by messages, in the patient's place.

Its poses and wrenches come whenever they come, each by itself; `DrivenPatient` joins
the newest of both for the follower's loop, and hands the loop's target to the robot. A
robot or a sensor that falls silent is a measurement that is not a number, and stops
both sides. `examples/openigtlink` and `examples/ros2` are drivers by it.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.live.messages import Sample
from ttus_opt.probe.pose import rotations

#: Age from which a pose or a wrench says nothing of now [s]: ten frames of the loop
SILENCE = 0.1


class DrivenPatient:
    """The newest pose and wrench of a robot, as the follower's loop wants them.

    All methods are called by one thread.
    """

    def __init__(
        self,
        command: Callable[[Array, Array], None],
        poll: Callable[[], None] | None = None,
    ) -> None:
        """A robot of which nothing was heard.

        Args:
            command: Sends the robot a target: rotation, probe to patient, (3, 3) [–],
                and position, patient frame, (3,) [m].
            poll: Takes what came by now; None where messages come by themselves.
        """
        self._command, self._poll = command, poll
        self._posed = self._felt = -math.inf
        self._rotation, self._position = np.eye(3), np.zeros(3)
        self._wrench = np.full(6, math.nan)

    def take_pose(self, now: float, rotation: Array, position: Array) -> None:
        """A pose came.

        Args:
            now: Follower's clock [s].
            rotation: Probe to patient, shape (3, 3) [–].
            position: Origin of the probe frame, patient frame, shape (3,) [m].

        Raises:
            InputError: No rigid pose; the last one stays.
        """
        at = np.array(position, dtype=float)
        if at.shape != (3,) or not np.isfinite(at).all():
            raise InputError("a position must be three finite numbers [m]")
        self._rotation = rotations(np.asarray(rotation, dtype=float)[None])[0]
        self._position, self._posed = at, now

    def take_wrench(self, now: float, wrench: Array) -> None:
        """A wrench came: on the probe, patient axes, gravity taken off, (6,) [N, N·m].

        Args:
            now: Follower's clock [s].
            wrench: Force, then torque about the shell's reference.
        """
        self._wrench, self._felt = np.array(wrench, dtype=float), now

    def ready(self, now: float) -> bool:
        """Whether the newest pose and wrench are of now."""
        return now - min(self._posed, self._felt) <= SILENCE

    @property
    def here(self) -> tuple[Array, Array]:
        """The newest pose: rotation (3, 3) and position (3,) [m]."""
        return self._rotation.copy(), self._position.copy()

    def sense(self, time: float, rotation: Array, position: Array) -> Sample:
        """Command the target, and join the newest pose and wrench."""
        if self._poll is not None:
            self._poll()
        self._command(rotation, position)
        wrench = self._wrench.copy() if self.ready(time) else np.full(6, math.nan)
        return Sample(time, self._rotation, self._position, wrench)
