"""Patients: a recording that plays, and simulated tissue that breathes.

Breathing moves all skin of the front to and fro; a camera sees where it was a moment
ago.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.live.messages import Sample
from ttus_opt.live.tissue import Tissue
from ttus_opt.phantom.recording import FORCE_NOISE, TORQUE_NOISE
from ttus_opt.probe.trajectory import Trajectory

#: Direction of the front, in which breathing moves the skin
FRONT = np.array([0.0, 1.0, 0.0])

#: Time constant with which a simulated probe follows its target [s]
LAG = 0.01


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


class SimulatedPatient:
    """Tissue that breathes, a probe that follows its target, and a noisy sensor.

    Attributes:
        tissue: What answers the probe.
        breathing: How the skin moves.
    """

    def __init__(
        self,
        tissue: Tissue,
        *,
        breathing: Breathing | None = None,
        seed: int = 0,
    ) -> None:
        """A patient at rest.

        Args:
            tissue: What answers the probe.
            breathing: How the skin moves; at rest by default.
            seed: Of the noise.
        """
        self.tissue, self.breathing = tissue, breathing or Breathing()
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
            share = 1.0 - math.exp(-step / LAG)
            reached = before.position + share * (position - before.position)
            moved = reached - before.position
            velocity = moved / step if step > 0.0 else self._last_velocity
        self._last_velocity = velocity
        wrench = self.wrench(time, rotation, reached, velocity)
        self._at = Sample(time, rotation, reached, wrench)
        scale = np.repeat([FORCE_NOISE, TORQUE_NOISE], 3)
        noisy = wrench + scale * self._rng.standard_normal(6)
        return replace(self._at, wrench=noisy)

    def wrench(
        self, time: float, rotation: Array, position: Array, velocity: Array
    ) -> Array:
        """Force, then torque without noise, shape (6,) [N, N·m]."""
        still = position - self.breathing.shift(time)
        return self.tissue.wrench(rotation, still, velocity)


#: Time over which the skin's motion is taken as straight; longest time to go on after
#: the newest image [s]
SPAN, AHEAD = 0.1, 0.2


class SkinMotion:
    """Displacement of the skin, continued along a line through the last images.

    A breath of 5 mm at 0.25 Hz moves the skin by 0.4 mm in the 50 ms that an image is
    old. A model takes that for the patient's stiffness: in `trial`, at a delay of a
    second, the hand then feels 0.9 N too much or too little. The line leaves 0.1 N.
    """

    def __init__(self) -> None:
        """A skin of which nothing was seen is at rest."""
        self._seen: deque[tuple[float, Array]] = deque()

    def see(self, time: float, displacement: Array) -> None:
        """Take an image; one that is not newer than the last is ignored.

        Args:
            time: When it was taken, by the follower's clock [s].
            displacement: Of the skin from rest, patient frame, shape (3,) [m].

        Raises:
            InputError: A displacement that is not three finite numbers.
        """
        shift = np.array(displacement, dtype=float)
        if shift.shape != (3,) or not np.isfinite([time, *shift]).all():
            raise InputError("a displacement of the skin must be three finite numbers")
        if self._seen and time <= self._seen[-1][0]:
            return
        self._seen.append((time, shift))
        while time - self._seen[0][0] > SPAN:
            self._seen.popleft()

    def at(self, time: float) -> Array:
        """Displacement at a time, shape (3,) [m]; least squares, at most `AHEAD` on."""
        if not self._seen:
            return np.zeros(3)
        times = np.array([seen for seen, _ in self._seen])
        shifts = np.array([shift for _, shift in self._seen])
        middle = float(times.mean())
        mean: Array = shifts.mean(axis=0)
        spread = float(np.sum((times - middle) ** 2))
        if spread == 0.0:
            return mean
        velocity: Array = (times - middle) @ (shifts - mean) / spread
        ahead = min(time, float(times[-1]) + AHEAD) - middle
        return np.asarray(mean + ahead * velocity)
