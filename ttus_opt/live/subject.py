"""Who is examined with what probe, and how a simulated hand does it.

The hand presses three places in turn, again and again. The example's subject is its
torso; any other is a surface and a probe, mesh or primitive.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial

import numpy as np

from ttus_opt import example
from ttus_opt.contact.standing import skin_frames, standing
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.probe.held import hold
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.scan.surface import Surface

#: Farthest that a device's handle gets from where the hand wants it [m]
REACH = 0.05

#: Time between changes of the rotation [s]
TURNS = 5e-3

#: Mass [kg], stiffness [N/m] and damping [N·s/m] of hand and device
MASS, STIFFNESS, DAMPING = 0.4, 500.0, 15.0


class Hand:
    """A hand that follows a path of the probe and yields to force.

    Arm and device are a mass on a spring and a damper whose other end follows the
    intended motion. Values of a hand that holds a stylus: 0.1 to 1 kN/m, 5 to 20 N·s/m
    (K. J. Kuchenbecker, J. G. Park, G. Niemeyer, IMECE 2003-42600; T. L. Gibo, A. J.
    Bastian, A. M. Okamura, IEEE World Haptics 2013).

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


#: Points of the shell of a primitive, and of a mesh, whose face is a small part [–]
N_POINTS, MESH_POINTS = 1000, 4000

#: Time before the first press, in which both sides meet; of a press [s]
MEETING, PRESS = 2.0, 2.0

#: Places, across the body and along it from the middle one [m]
PLACES = np.array([[0.0, -0.008], [0.008, 0.007], [-0.008, 0.002]])

#: Depths that the hand intends: lifted, and the way down from there [m]
LIFTED, WAY = -0.006, 0.026

#: Length of one examination, and of its steps [s]
ROUND, STEP = MEETING + len(PLACES) * PRESS, 0.05


@dataclass(frozen=True)
class Subject:
    """A patient's skin, a probe, and where it is held how.

    Attributes:
        surface: The skin.
        shell: The probe.
        hold: Orientation of the probe relative to the skin (`probe.held.hold`).
        place: Angle [rad] and height [m] of the middle place; by default the middle of
            the front.
    """

    surface: Surface
    shell: PointShell = field(repr=False)
    hold: Array = field(default_factory=hold, repr=False)
    place: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Refuse a place beyond the surface."""
        z = self.surface.z
        if not z[0] <= self._place[1] <= z[-1]:
            raise InputError(
                f"the middle place must lie on the surface, z {z[0]:.3f} to {z[-1]:.3f}"
                f" m, got {self._place[1]:.3f} m"
            )

    @property
    def _place(self) -> tuple[float, float]:
        z = self.surface.z
        return self.place or (0.5 * np.pi, 0.5 * float(z[0] + z[-1]))

    def examination(self) -> Trajectory:
        """What the hand intends, `ROUND` long; to be repeated from `MEETING` on."""
        time = np.arange(0.0, ROUND + 0.5 * STEP, STEP)
        phase = np.maximum(time - MEETING, 0.0) / PRESS
        number = (phase + 1e-9).astype(int) % len(PLACES)
        depth = LIFTED + WAY * np.sin(np.pi * phase) ** 2
        angle, z = self._place
        radius = self.surface.radius_at(np.array([angle]), np.array([z]))
        places = angle - PLACES[:, 0] / radius, z + PLACES[:, 1]
        turns, touching = standing(self.surface, self.shell, self.hold, *places, 0.0)
        outward = skin_frames(self.surface, *places)[:, :, 0]
        # places change while the probe is lifted
        position = touching[number] - depth[:, None] * outward[number]
        return Trajectory(time, position, turns[number])

    @property
    def start(self) -> tuple[Array, Array]:
        """Where the hand begins: rotation (3, 3) [–] and position (3,) [m]."""
        path = self.examination()
        return path.rotation[0], path.position[0]

    def device(self) -> Callable[[], Hand]:
        """Makes the simulated hand that examines again and again, in any process."""
        return partial(Hand, self.examination(), again=MEETING)


@cache
def patient_surface() -> Surface:
    """The example's skin."""
    return Surface.load(example.path("surface.nc"))


@cache
def probe_shell() -> PointShell:
    """The example's probe."""
    return shell_of(example.PROBE)


@cache
def example_subject() -> Subject:
    """The example's torso and probe."""
    return Subject(patient_surface(), probe_shell(), place=(0.5 * np.pi, 0.138))


def shell_of(probe: str) -> PointShell:
    """A probe as `PointShell.from_spec` takes it, with the points of a live session."""
    points = N_POINTS if ":" in probe else MESH_POINTS
    return PointShell.from_spec(probe, n_points=points)
