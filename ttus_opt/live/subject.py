"""Who is examined with what probe, and how a simulated hand does it.

The hand presses three places in turn, again and again. The example's subject is its
torso; any other is a surface and a probe, mesh or primitive.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial

import numpy as np

from ttus_opt import example
from ttus_opt.contact.standing import skin_frames, standing
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.live.hand import Hand
from ttus_opt.probe.held import hold
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.scan.surface import Surface

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
