"""Contact wrenches from raw readings of a force sensor (docs/method/sensors.md, 19.2).

Bias, weight and, on request, the load's inertia are subtracted; the rest is rotated
into the frame of the poses and moved to the point shell's reference point.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.sensors.force_sensor import ForceSensor
from ttus_opt.sensors.tool_load import ToolLoad, gravity_in_sensor

#: Frames of the parabola from which an acceleration is taken; fewest of a segment
WINDOW = 7


def compensated(
    raw: Trajectory,
    sensor: ForceSensor,
    load: ToolLoad,
    down: ArrayLike,
    reference: Array,
    *,
    inertia: bool = False,
) -> Trajectory:
    """A recording with the contact wrench alone.

    Args:
        raw: Raw readings, sensor axes, about the sensor's reference point.
        sensor: How it is mounted.
        load: What it reads without contact.
        down: Direction of gravity in the frame of the poses, shape (3,).
        reference: The point shell's reference point, probe frame, shape (3,) [m].
        inertia: Subtract the force that accelerates the load, as a point mass at its
            centre; its rotary inertia is neglected.

    Returns:
        The same poses; force on the probe and torque about ``reference``, axes of the
        frame of the poses.

    Raises:
        InputError: No readings, or too few frames for an acceleration.
    """
    force, torque = sensor.readings(raw, "recording")
    pull = gravity_in_sensor(raw, sensor, down)
    world = raw.rotation @ sensor.axes  # sensor to the frame of the poses
    if inertia:
        centre = sensor.point + sensor.axes @ load.centre
        pull -= np.einsum("tji,tj->ti", world, _acceleration(raw, centre))
    weight = load.mass * pull
    force = force - load.force_bias - weight
    torque = torque - load.torque_bias - np.cross(load.centre, weight)
    force, torque = (np.einsum("tij,tj->ti", world, v) for v in (force, torque))
    arm = raw.rotation @ (np.asarray(reference, np.float64) - sensor.point)
    return replace(raw, force=force, torque=torque - np.cross(arm, force))


def _acceleration(raw: Trajectory, centre: Array) -> Array:
    """Acceleration of a point of the probe, frame of the poses, shape (T, 3) [m/s²].

    Twice the leading coefficient of the least-squares parabola through `WINDOW` frames
    (Savitzky and Golay 1964), for uneven steps too.
    """
    place = raw.position + raw.rotation @ centre
    out = np.empty_like(place)
    for part in raw.parts:
        if part.stop - part.start < WINDOW:
            raise InputError(
                f"inertia needs {WINDOW} frames in a recording, got "
                f"{part.stop - part.start}: leave it out"
            )
        for frame in range(part.start, part.stop):
            first = min(max(frame - WINDOW // 2, part.start), part.stop - WINDOW)
            near = slice(first, first + WINDOW)
            time = raw.time[near] - raw.time[frame]
            # scaled to the span, so that the fit is well conditioned
            span = float(np.ptp(time))
            out[frame] = 2.0 * np.polyfit(time / span, place[near], 2)[0] / span**2
    return out
