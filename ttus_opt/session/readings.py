"""Third to fifth step of a session: one clock, contact wrenches, then trajectories.

Raw readings in free air are bias plus weight. Their rate of change gives the offset
between the clocks before either is known
(`ttus_opt.sensors.clock.gravity_of_readings`); interpolated at the poses' times, they
then give bias, weight and centre of mass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ttus_opt.core.errors import InputError
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.scan.surface import Surface
from ttus_opt.sensors import clock
from ttus_opt.sensors.streams import WrenchStream
from ttus_opt.sensors.tool_load import ToolLoad, identify_load
from ttus_opt.sensors.wrench_compensation import compensated
from ttus_opt.session.description import Description, Part
from ttus_opt.session.registration import Registration, gravity

#: Least correlation of weight and tilts: in free air nothing else changes the readings
LEAST_GRAVITY = 0.8


@dataclass(frozen=True)
class Timing:
    """The offset between the clocks, and how it was found.

    Attributes:
        offset: Time to add to the times of forces [s].
        first: Signal from the poses; None if the offset was given.
        second: Signal from the forces, on their own clock.
        correlation: Correlation at the offset.
    """

    offset: float
    first: clock.Signal | None = field(default=None, repr=False)
    second: clock.Signal | None = field(default=None, repr=False)
    correlation: float | None = None


def synchronise(
    session: Description,
    poses: Trajectory,
    wrenches: WrenchStream,
    surface: Surface,
    registration: Registration,
) -> Timing:
    """The offset between the clocks.

    Args:
        session: The description.
        poses: Poses of the probe, patient frame.
        wrenches: On their own clock.
        surface: Surface of the patient.
        registration: Motions between the frames.

    Raises:
        InputError: The streams do not show the same motion.
    """
    plan = session.clock
    if plan.by == "offset":
        return Timing(plan.offset)
    around = float(poses.time[0] - wrenches.time[0]) if plan.together else 0.0
    if plan.by == "gravity":
        assert session.free is not None
        own = stretch(poses, session.free, float(poses.time[0]))
        first = clock.gravity_of_poses(own, gravity(session, registration))
        second = clock.gravity_of_readings(wrenches.time, wrenches.force)
    else:
        second = clock.contact_of_force(wrenches.time, wrenches.force)
        share = float(second.values.mean())
        first = clock.contact_of_poses(poses, surface, share)
    found = clock.clock_offset(
        first, second, around=around, largest=plan.largest_offset
    )
    if plan.by == "gravity" and found.correlation < LEAST_GRAVITY:
        raise InputError(
            "forces in free air follow the tilts of the probe with a correlation of "
            f"{found.correlation:.2f} at best, {LEAST_GRAVITY:g} is needed: is free "
            "the interval in free air, and largest_offset large enough?"
        )
    return Timing(found.seconds, first, second, found.correlation)


def contact_wrenches(
    session: Description,
    joined: Trajectory,
    shell: PointShell,
    registration: Registration,
    begin: float,
) -> tuple[Trajectory, ToolLoad | None]:
    """Contact wrenches at the poses' times, patient frame.

    Args:
        session: The description.
        joined: Poses, patient frame, with readings as recorded.
        shell: The probe.
        registration: Motions between the frames.
        begin: Time of the tracker's first pose [s].

    Returns:
        Force on the probe and torque about the shell's reference, and the load that
        was subtracted; None where the readings were compensated already.

    Raises:
        InputError: Readings that contradict how the sensor is mounted, or no torques.
        GeometryError: The free poses hardly tilt the sensor.
    """
    sensor = session.force.sensor
    if sensor is None or session.free is None:
        return _turned(joined, session.force.frame, registration), None
    down = gravity(session, registration)
    load = identify_load(stretch(joined, session.free, begin), sensor, down)
    return compensated(joined, sensor, load, down, shell.reference), load


def _turned(joined: Trajectory, frame: str, registration: Registration) -> Trajectory:
    """Contact wrenches rotated from another frame's axes to the patient's."""
    if frame == "probe":
        turn = joined.rotation
    else:
        turn = registration.rotation_to_patient(frame)
    force, torque = (
        None if v is None else np.einsum("...ij,...j->...i", turn, v)
        for v in (joined.force, joined.torque)
    )
    return replace(joined, force=force, torque=torque)


#: Fewest frames of a stretch
LEAST_FRAMES = 10


def stretch(recorded: Trajectory, part: Part, begin: float) -> Trajectory:
    """The frames of a stretch, segments numbered from 0.

    Args:
        recorded: All frames.
        part: The stretch.
        begin: Time of the tracker's first pose [s].

    Raises:
        InputError: It has too few frames.
    """
    time = recorded.time - begin
    inside = (time >= part.start) & (time <= part.end)
    if inside.sum() < LEAST_FRAMES:
        raise InputError(
            f"{part.name} has {int(inside.sum())} frames from {part.start:g} to "
            f"{part.end:g} s, at least {LEAST_FRAMES} are needed: the recording runs "
            f"from {time[0]:.4g} to {time[-1]:.4g} s after the tracker's first pose"
        )
    out = recorded.select(inside)
    segment = np.unique(out.segment, return_inverse=True)[1]
    return replace(out, segment=segment.reshape(-1).astype(np.int64))


def cut(
    recorded: Trajectory, parts: Sequence[Part], begin: float
) -> dict[str, Trajectory]:
    """The recordings by name.

    Args:
        recorded: Contact wrenches, patient frame.
        parts: The stretches.
        begin: Time of the tracker's first pose [s].

    Raises:
        InputError: A stretch has too few frames, or one to fit to overlaps one to test
            on.
    """
    for fitted in parts:
        for other in parts:
            apart = fitted.end <= other.start or other.end <= fitted.start
            if fitted.fitted and not other.fitted and not apart:
                raise InputError(
                    f"{fitted.name} (fit) and {other.name} (test) overlap: a field is "
                    "tested on what it has not seen"
                )
    return {part.name: stretch(recorded, part, begin) for part in parts}
