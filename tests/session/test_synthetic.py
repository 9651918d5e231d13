"""What a synthetic recording shows is what its truth says, undone frame by frame."""

import functools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ttus_opt.phantom.example_data import frame
from ttus_opt.probe.rigid_motion import homogeneous, inverse
from ttus_opt.session import synthetic

G = 9.80665
SECONDS = 4.0


@functools.cache
def moved():
    return synthetic._motion_of_all(SECONDS, np.random.default_rng(1))


def test_recordings_stand_where_they_are_said_to():
    whole, stretches = moved()
    for name, own in synthetic.perfect(SECONDS).items():
        start, end = stretches[name]
        part = whole.select((whole.time >= start) & (whole.time <= end))
        np.testing.assert_allclose(part.time - start, own.time, atol=1e-9)
        np.testing.assert_array_equal(part.position, own.position)
        np.testing.assert_array_equal(part.force, own.force)
    tilted = whole.select(whole.time < synthetic.FREE)
    assert tilted.force is not None and not tilted.force.any()


def test_the_tracker_sees_the_target_on_the_probe():
    """Carried back to the patient: the probe's pose, but for noise."""
    whole, _ = moved()
    truth = synthetic.Truth()
    seen = synthetic._tracked(whole, truth, np.random.default_rng(2))
    to_patient = frame().scan_to_patient @ truth.tracker_to_scan
    target = homogeneous(seen.rotation, seen.position)
    probe = to_patient @ target @ inverse(truth.target_to_probe)
    at = np.array(
        [np.interp(seen.time, whole.time, column) for column in whole.position.T]
    ).T
    gap = np.linalg.norm(probe[:, :3, 3] - at, axis=1)
    # the target is 13 cm from the probe's origin, its turn off by 0.05° an axis
    assert np.median(gap) < 3.0 * synthetic.SHIFT_NOISE
    assert (np.diff(seen.time) > 1.0).sum() == 4  # hidden in every pause


def test_the_sensor_reads_contact_weight_and_bias():
    """Undone by the formulas of statics, one reading after the other."""
    whole, _ = moved()
    truth = synthetic.Truth()
    times = np.arange(0.0, whole.time[-1], 1.0 / synthetic.SENSOR_RATE)
    read = synthetic.sensed(whole, times, truth, np.random.default_rng(3))
    time = read.time + truth.offset
    rng = np.random.default_rng(4)
    forces, torques = [], []
    nodes = np.searchsorted(whole.time, time)
    inner = np.flatnonzero(
        np.isclose(whole.time[np.minimum(nodes, len(whole) - 1)], time)
    )
    for k in rng.choice(inner, 150, replace=False).tolist():
        i = int(nodes[k])
        axes = whole.rotation[i] @ truth.axes  # sensor to patient
        weight = truth.mass * G * synthetic.DOWN
        f = axes @ (read.force[k] - truth.force_bias) - weight
        moment = np.cross(axes @ truth.centre, weight)
        t = axes @ (read.torque[k] - truth.torque_bias) - moment
        # to the probe's origin, from where the sensor is
        t = t + np.cross(whole.rotation[i] @ truth.point, f)
        forces.append(f - whole.force[i])
        torques.append(t - whole.torque[i])
    assert np.std(forces) == pytest.approx(synthetic.FORCE_NOISE, rel=0.2)
    spread = np.hypot(synthetic.TORQUE_NOISE, 0.0805 * synthetic.FORCE_NOISE)
    assert np.std(torques) < 1.5 * spread
    assert np.abs(
        np.mean(forces, axis=0)
    ).max() < 5.0 * synthetic.FORCE_NOISE / np.sqrt(150)


def test_tags_close_the_loop():
    truth = synthetic.Truth()
    pairs = np.array(synthetic._tag_pairs(truth, np.random.default_rng(5)))
    assert pairs.shape == (synthetic.TAG_POSES, 2, 4, 4)
    loop = inverse(pairs[:, 0]) @ truth.tracker_to_scan @ pairs[:, 1]
    off = loop @ truth.tag_to_target
    angle = Rotation.from_matrix(off[:, :3, :3]).magnitude()
    assert np.median(angle) < np.deg2rad(0.3) and np.deg2rad(0.01) < np.median(angle)
    assert np.median(np.linalg.norm(off[:, :3, 3], axis=1)) < 2e-3
