"""Raw readings of a force sensor, from a contact wrench and a load that are known."""

import numpy as np
from scipy.spatial.transform import Rotation

from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.sensors.force_sensor import ForceSensor

DOWN = np.array([0.0, 0.0, -1.0])
G = 9.80665

MASS = 0.42
CENTRE = np.array([0.004, -0.002, 0.051])  # from the reference point, sensor axes
FORCE_BIAS = np.array([1.5, -2.0, 4.0])
TORQUE_BIAS = np.array([0.02, -0.05, 0.01])

SENSOR = ForceSensor(
    Rotation.from_rotvec([0.1, 0.2, 0.8]).as_matrix(), np.array([0.01, 0.0, -0.08])
)


def readings(
    rotation,
    force=0.0,
    torque=0.0,
    *,
    sensor=SENSOR,
    acceleration=0.0,
    mass=MASS,
    position=None,
    noise=0.0,
):
    """What a sensor reads, written out frame by frame.

    Force on the probe and torque about the sensor's point: axes of the poses' frame.
    """
    rng = np.random.default_rng(5)
    n = len(rotation)
    raw = np.empty((n, 6))
    shape = (n, 3)
    forces, torques = np.broadcast_to(force, shape), np.broadcast_to(torque, shape)
    accelerations = np.broadcast_to(acceleration, shape)
    for i in range(n):
        to_sensor = (rotation[i] @ sensor.axes).T
        weight = to_sensor @ (mass * (G * DOWN - accelerations[i]))
        f = to_sensor @ forces[i] + weight + FORCE_BIAS
        t = to_sensor @ torques[i] + np.cross(CENTRE, weight) + TORQUE_BIAS
        raw[i] = np.concatenate([f, t]) * (1.0 if sensor.sign == "on-probe" else -1.0)
    raw += noise * rng.normal(size=raw.shape) * [1, 1, 1, 0.05, 0.05, 0.05]
    return Trajectory(
        0.05 * np.arange(n),
        np.zeros((n, 3)) if position is None else position,
        rotation,
        raw[:, :3].copy(),
        raw[:, 3:].copy(),
    )


def tilts(n=40, size=0.6):
    """Random turns of the probe."""
    rng = np.random.default_rng(2)
    return Rotation.from_rotvec(rng.normal(0, size, (n, 3))).as_matrix()
