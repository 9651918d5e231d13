"""Bias, weight and centre of mass from free poses; false statements are noticed."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.kit import refuses
from tests.sensors.readings import (
    CENTRE,
    DOWN,
    FORCE_BIAS,
    MASS,
    SENSOR,
    TORQUE_BIAS,
    readings,
    tilts,
)
from ttus_opt.core.errors import GeometryError, InputError, TtusWarning
from ttus_opt.sensors.force_sensor import ForceSensor
from ttus_opt.sensors.tool_load import identify_load


@pytest.mark.parametrize("sign", ["on-probe", "by-probe"])
def test_a_known_load_is_found(sign):
    sensor = replace(SENSOR, sign=sign)
    load = identify_load(readings(tilts(), sensor=sensor), sensor, DOWN)
    assert load.mass == pytest.approx(MASS, abs=1e-9)
    np.testing.assert_allclose(load.centre, CENTRE, atol=1e-9)
    np.testing.assert_allclose(load.force_bias, FORCE_BIAS, atol=1e-9)
    np.testing.assert_allclose(load.torque_bias, TORQUE_BIAS, atol=1e-9)
    assert load.handedness_told


def test_standard_errors_are_those_of_noise():
    loads = []
    for seed in range(60):
        free = readings(tilts())
        rng = np.random.default_rng(seed)
        free = replace(
            free,
            force=free.force + rng.normal(0, 0.1, free.force.shape),
            torque=free.torque + rng.normal(0, 0.005, free.torque.shape),
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", TtusWarning)  # drift by chance
            loads.append(identify_load(free, SENSOR, DOWN))
    sampled = np.std([load.mass for load in loads])
    assert np.mean([load.mass_std for load in loads]) == pytest.approx(sampled, rel=0.3)
    assert np.mean([load.mass for load in loads]) == pytest.approx(MASS, abs=0.005)
    sampled_centre = np.std([load.centre for load in loads], axis=0)
    told_centre = np.mean([load.centre_std for load in loads], axis=0)
    np.testing.assert_allclose(told_centre, sampled_centre, rtol=0.35)
    assert loads[0].force_residual == pytest.approx(0.1, rel=0.2)
    assert loads[0].torque_residual == pytest.approx(0.005, rel=0.2)


@pytest.mark.filterwarnings("ignore::ttus_opt.core.errors.TtusWarning")
def test_residuals_of_few_poses_are_not_too_small():
    """Eight poses, of which four and six numbers are found: the noise all the same."""
    free, squares = readings(tilts(8)), []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        force = free.force + rng.normal(0, 0.02, free.force.shape)
        torque = free.torque + rng.normal(0, 0.001, free.torque.shape)
        load = identify_load(replace(free, force=force, torque=torque), SENSOR, DOWN)
        squares.append([load.force_residual**2, load.torque_residual**2])
    # the mean of 200 with 20 and 18 degrees of freedom is off by 2.4 %
    np.testing.assert_allclose(np.mean(squares, axis=0), [4e-4, 1e-6], rtol=0.08)


@pytest.mark.parametrize("sign", ["on-probe", "by-probe"])
def test_the_other_sign_is_noticed(sign):
    free = readings(tilts(), sensor=replace(SENSOR, sign=sign), noise=0.05)
    other = {"on-probe": "by-probe", "by-probe": "on-probe"}[sign]
    with pytest.raises(InputError, match=f"give sign={sign}"):
        identify_load(free, replace(SENSOR, sign=other), DOWN)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_left_handed_sensor_is_noticed(axis):
    free = readings(tilts(), noise=0.05)
    for values in (free.force, free.torque):
        values[:, axis] *= -1
    with pytest.raises(InputError, match=f"left-handed.*the {'xyz'[axis]} axis"):
        identify_load(free, SENSOR, DOWN)


def test_axes_that_are_turned_are_noticed_and_mended():
    free = readings(tilts(), noise=0.02)
    with pytest.raises(InputError, match="from the stated axes: give axes=") as told:
        identify_load(free, replace(SENSOR, axes=np.eye(3)), DOWN)
    quaternion = str(told.value).split("give axes=")[1].split(" ")[0].split(",")
    axes = Rotation.from_quat([float(v) for v in quaternion]).as_matrix()
    np.testing.assert_allclose(axes, SENSOR.axes, atol=0.02)
    load = identify_load(free, replace(SENSOR, axes=axes), DOWN)
    assert load.mass == pytest.approx(MASS, abs=0.01)


def about(*axes, n=12):
    """Turns about a few axes, one after the other."""
    angles = np.linspace(-1.2, 1.2, n)
    turns = [np.outer(angles, axis) for axis in axes]
    return Rotation.from_rotvec(np.concatenate(turns)).as_matrix()


def test_poses_that_hardly_tilt_are_refused():
    for rotation in (about([0, 0, 1.0]), tilts(20, 0.02)):
        with pytest.raises(GeometryError, match="tilted by 30°"):
            identify_load(readings(rotation), SENSOR, DOWN)


def test_tilts_in_a_plane_find_the_load_but_no_handedness():
    plane = about([1.0, 0, 0], n=30)  # gravity stays in the plane of y and z
    plain = ForceSensor()
    load = identify_load(readings(plane, sensor=plain, noise=0.005), plain, DOWN)
    assert load.mass == pytest.approx(MASS, abs=0.01)
    assert not load.handedness_told
    with pytest.raises(InputError, match="give sign=on-probe, or give axes="):
        identify_load(
            readings(plane, sensor=plain), replace(plain, sign="by-probe"), DOWN
        )


def test_drift_is_told():
    free = readings(tilts(200), noise=0.01)
    free.force[:, 1] += 0.01 * free.time
    with pytest.warns(TtusWarning, match=r"drifts by 0\.6\d* N a minute"):
        load = identify_load(free, SENSOR, DOWN)
    np.testing.assert_allclose(load.drift, [0, 0.01, 0], atol=5e-4)
    assert load.facts()["drift_N_per_s"] == load.drift.tolist()


def test_readings_without_weight_are_told():
    free = readings(tilts(), mass=0.0, noise=0.05)
    with pytest.warns(TtusWarning, match="compensated already"):
        load = identify_load(free, SENSOR, DOWN)
    assert load.mass == 0.0
    assert not load.handedness_told
    np.testing.assert_allclose(load.force_bias, FORCE_BIAS, atol=0.05)


def test_what_is_refused():
    free = readings(tilts())
    for given, told in (
        (free.select(slice(0, 7)), "at least 8 free poses"),
        (replace(free, torque=None), "forces and torques"),
        (replace(free, force=1e5 * free.force), "counts"),
    ):
        refuses(InputError, told, identify_load, given, SENSOR, DOWN)
    for down in ([0, 0, 0], [1, 2], [np.nan, 0, 1], [np.inf, 0, 0]):
        refuses(InputError, "down must be a dir", identify_load, free, SENSOR, down)
