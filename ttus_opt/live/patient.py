"""Patients: the finite-element torso pressed by a probe, which breathes; a recording.

The torso's compliance (`ttus_opt.phantom`) is a response at poses: a contact takes less
than a millisecond and no mesh. The bundled one was made on a mesh twice as coarse as
that of the example's recordings. Breathing moves all skin of the front to and fro.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Protocol

import numpy as np

from ttus_opt import example
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import GeometryError, InputError
from ttus_opt.live.messages import Sample
from ttus_opt.phantom.elasticity import SkinPatch
from ttus_opt.phantom.press import CoulombDrag, Motion, press
from ttus_opt.phantom.probe import EllipsoidProbe
from ttus_opt.phantom.recording import FORCE_NOISE, TORQUE_NOISE
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.scan.surface import Surface

#: Direction of the front, in which breathing moves the skin
FRONT = np.array([0.0, 1.0, 0.0])


class Patient(Protocol):
    """Anything that a probe can touch: a simulation, a recording, a robot's driver."""

    def sense(self, time: float, rotation: Array, position: Array) -> Sample:
        """Move the probe towards a pose and measure.

        Args:
            time: Follower's clock [s].
            rotation: Target, probe to patient, shape (3, 3) [–].
            position: Target, patient frame, shape (3,) [m].

        Returns:
            Where the probe is and what it feels.
        """


class RecordedPatient:
    """A recording of a pressed probe that plays in time.

    It obeys no target: the probe is where it was, and measured what it measured. The
    operator's model learns from it as from a robot, and its own poses are answered by
    that model alone.

    Attributes:
        seconds: Length [s].
        played: Time of the recording that was sensed last [s].
    """

    def __init__(self, recorded: Trajectory, begins: Callable[[], bool]) -> None:
        """A recording at its first frame.

        Args:
            recorded: One recording with force and torque.
            begins: Whether it may begin; asked until it says so once.

        Raises:
            InputError: No force, no torque, or several recordings.
        """
        if recorded.force is None or recorded.torque is None:
            raise InputError("a recording to replay needs force and torque")
        if recorded.segment[-1] != recorded.segment[0]:
            raise InputError("replay one recording, not several in one file")
        self._recorded, self._begins, self._start = recorded, begins, math.nan
        self._wrench = np.hstack([recorded.force, recorded.torque])
        self._times = recorded.time - recorded.time[0]
        self.seconds, self.played = float(self._times[-1]), 0.0

    def sense(self, time: float, rotation: Array, position: Array) -> Sample:
        """The newest frame by now, the first before it begins, the last after it."""
        if math.isnan(self._start) and self._begins():
            self._start = time
        begun = 0.0 if math.isnan(self._start) else time - self._start
        k = int(np.searchsorted(self._times, begun + 1e-9, side="right")) - 1
        self.played = float(self._times[k])
        taken = time if math.isnan(self._start) else self._start + self.played
        R, at = self._recorded.rotation[k], self._recorded.position[k]
        return Sample(taken, R, at, self._wrench[k])


@dataclass(frozen=True)
class Breathing:
    """Motion of the skin: amplitude [m] and frequency [Hz]."""

    amplitude: float = 0.0
    frequency: float = 0.25

    def shift(self, time: float) -> Array:
        """Displacement of the skin, shape (3,) [m]."""
        phase = 2.0 * math.pi * self.frequency * time
        return self.amplitude * math.sin(phase) * FRONT


@cache
def bundled_patch() -> SkinPatch:
    """The bundled torso's skin and compliance."""
    with np.load(example.path("skin.npz")) as stored:
        lower, n = stored["compliance"], len(stored["points"])
        compliance = np.zeros((n, n))
        compliance[np.tril_indices(n)] = lower
        compliance += np.tril(compliance, -1).T
        return SkinPatch(stored["points"], stored["normals"], stored["rim"], compliance)


class SimulatedPatient:
    """The torso, a probe that follows its target, and a noisy sensor.

    Attributes:
        breathing: How the skin moves.
        touched: Whether the probe touched anything in the last step.
    """

    def __init__(
        self,
        *,
        friction: float = 0.0,
        breathing: Breathing | None = None,
        noise: float = 1.0,
        lag: float = 0.01,
        seed: int = 0,
        probe: EllipsoidProbe | None = None,
    ) -> None:
        """A patient at rest.

        Args:
            friction: Coulomb coefficient [–].
            breathing: How the skin moves; at rest by default.
            noise: Of the sensor, in units of the example's [–].
            lag: Time constant with which the probe follows its target [s].
            seed: Of the noise.
            probe: The probe; by default the example's.
        """
        self._patch = bundled_patch()
        self._probe = probe or EllipsoidProbe((0.030, 0.0125, 0.018))
        self._drag = CoulombDrag(friction)
        self.breathing = breathing or Breathing()
        self._noise, self._lag = noise, lag
        self._rng = np.random.default_rng(seed)
        self._at: Sample | None = None
        self._last_velocity = np.zeros(3)

    def sense(self, time: float, rotation: Array, position: Array) -> Sample:
        """Follow the target, and measure; see `Patient`."""
        before = self._at
        if before is None:
            reached, velocity = position.copy(), np.zeros(3)
        else:
            step = max(time - before.time, 0.0)
            share = 1.0 - math.exp(-step / self._lag)
            reached = before.position + share * (position - before.position)
            moved = reached - before.position
            velocity = moved / step if step > 0.0 else self._last_velocity
        self._last_velocity = velocity
        wrench = self.wrench(time, rotation, reached, velocity)
        self._at = Sample(time, rotation, reached, wrench)
        scale = self._noise * np.repeat([FORCE_NOISE, TORQUE_NOISE], 3)
        noisy = wrench + scale * self._rng.standard_normal(6)
        return replace(self._at, wrench=noisy)

    def wrench(
        self, time: float, rotation: Array, position: Array, velocity: Array
    ) -> Array:
        """Force, then torque without noise, shape (6,) [N, N·m]."""
        still = position - self.breathing.shift(time)
        try:
            contact = press(
                self._patch,
                self._probe,
                rotation,
                still,
                motion=Motion(velocity, np.zeros(3)),
                drag=self._drag,
            )
        except GeometryError:  # beside the patch, or too deep
            return np.zeros(6)
        return np.concatenate([contact.force, contact.torque])

    def surface(self, time: float, still: Surface) -> Surface:
        """What a camera sees of the skin at some time: a surface, shifted."""
        shift = self.breathing.shift(time)
        theta = still.theta[:, None]
        along = shift[0] * np.cos(theta) + shift[1] * np.sin(theta)
        # the front moves, the back lies on the table
        front = np.clip(np.sin(theta), 0.0, 1.0)
        return replace(still, radius=still.radius + along * front)
