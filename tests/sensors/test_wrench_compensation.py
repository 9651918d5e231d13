"""The wrench of contact comes back from raw readings, synthetic and real."""

from dataclasses import replace

import numpy as np
import pytest

from tests.sensors.readings import DOWN, SENSOR, readings, tilts
from ttus_opt.core.errors import InputError
from ttus_opt.probe.trajectory import read_trajectory
from ttus_opt.sensors.tool_load import identify_load
from ttus_opt.sensors.wrench_compensation import compensated

REFERENCE = np.array([0.0, 0.005, 0.03])


@pytest.mark.parametrize("sign", ["on-probe", "by-probe"])
def test_a_push_at_a_known_point_comes_back(sign):
    """A force that acts at the reference point has no torque about it."""
    sensor = replace(SENSOR, sign=sign)
    rotation = tilts(30, 0.3)
    force = np.random.default_rng(0).normal(0, 5, (30, 3))
    arm = rotation @ (REFERENCE - sensor.point)
    raw = readings(rotation, force, np.cross(arm, force), sensor=sensor)
    load = identify_load(readings(tilts(), sensor=sensor), sensor, DOWN)
    clean = compensated(raw, sensor, load, DOWN, REFERENCE)
    np.testing.assert_allclose(clean.force, force, atol=1e-9)
    np.testing.assert_allclose(clean.torque, 0.0, atol=1e-9)
    np.testing.assert_array_equal(clean.rotation, raw.rotation)


def test_inertia_of_a_steady_acceleration_is_taken_off():
    time = 0.05 * np.arange(30)
    acceleration = np.array([1.0, -2.0, 0.5])
    rotation = np.broadcast_to(tilts(1)[0], (30, 3, 3))
    raw = readings(
        rotation,
        acceleration=acceleration,
        position=0.5 * np.outer(time**2, acceleration),
    )
    load = identify_load(readings(tilts()), SENSOR, DOWN)
    left = compensated(raw, SENSOR, load, DOWN, REFERENCE)
    clean = compensated(raw, SENSOR, load, DOWN, REFERENCE, inertia=True)
    assert np.abs(left.force).max() > 0.5
    np.testing.assert_allclose(clean.force, 0.0, atol=1e-8)
    np.testing.assert_allclose(clean.torque, 0.0, atol=1e-8)
    with pytest.raises(InputError, match="inertia needs 7 frames"):
        compensated(
            raw.select(slice(0, 6)), SENSOR, load, DOWN, REFERENCE, inertia=True
        )


@pytest.mark.parametrize("run", ["A_20_17_30_18", "A_20_17_35_10", "B_20_16_44_10"])
def test_a_real_recording_comes_back(shared, run):
    """Real motion and contact, with a load and biases put on."""
    real = read_trajectory(shared / "wrench" / f"run_{run}.csv")
    # the file's torques are about the tool's origin, the sensor's about its own point
    arm = real.rotation @ SENSOR.point
    about_sensor = real.torque - np.cross(arm, real.force)
    raw = readings(real.rotation, real.force, about_sensor, position=real.position)
    free = readings(tilts(), noise=0.02)
    load = identify_load(free, SENSOR, DOWN)
    clean = compensated(raw, SENSOR, load, DOWN, np.zeros(3))
    assert np.abs(clean.force - real.force).max() < 0.05
    assert np.abs(clean.torque - real.torque).max() < 0.01


def test_recordings_without_readings():
    raw = readings(tilts())
    load = identify_load(raw, SENSOR, DOWN)
    with pytest.raises(InputError, match="forces and torques"):
        compensated(replace(raw, torque=None), SENSOR, load, DOWN, REFERENCE)
