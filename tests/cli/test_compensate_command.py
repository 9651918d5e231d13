"""``ttus-opt compensate``."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.cli.conftest import PROBE, empty, refused
from tests.sensors.readings import SENSOR, readings, tilts
from ttus_opt.probe.trajectory import read_trajectory

AXES = ",".join(map(str, Rotation.from_matrix(SENSOR.axes).as_quat()))
POINT = ",".join(map(str, SENSOR.point))


@pytest.fixture
def words(tmp_path):
    """A command on a raw recording of a push of 3 N and free poses."""
    readings(tilts(), noise=0.01).save(tmp_path / "free.csv")
    readings(tilts(20), np.array([3.0, 0, 0])).save(tmp_path / "raw.csv")
    return (
        f"compensate {tmp_path / 'raw.csv'} --free {tmp_path / 'free.csv'} "
        f"--probe {PROBE} --down 0,0,-1 --axes {AXES} --point={POINT}"
    )


@pytest.mark.slow
def test_the_contact_comes_back(run, words, output):
    answer = run(
        f"{words} --sign on-probe -o {output / 'c.csv'} --model {output / 'm.json'}"
    )
    assert "kg" in answer.out
    clean = read_trajectory(output / "c.csv")
    np.testing.assert_allclose(clean.force, np.tile([3.0, 0, 0], (20, 1)), atol=0.03)
    told = json.loads((output / "m.json").read_text())
    assert told["mass_kg"] == pytest.approx(0.42, abs=0.005)
    assert set(told["sensor"]) == {"axes", "point", "sign"}


@pytest.mark.slow
def test_false_statements_leave_nothing(run, words, output):
    to = f"-o {output / 'c.csv'} --model {output / 'm.json'}"
    refused(
        run(f"{words} --sign by-probe {to}"), "give --sign on-probe, or check --down"
    )
    refused(run(f"{words} --sign up {to}"), "one of on-probe, by-probe")
    refused(run(f"{words} --sign on-probe --down 0,0,0 {to}"), "down")
    refused(run(f"{words} --sign on-probe --axes 0,0,0,1 {to}"), "give --axes 0.049,")
    refused(run(f"{words} --sign on-probe --point 0,0,80 {to}"), "millimetres")
    both = f"-o {output / 'c.csv'} --model {output / 'c.csv'}"
    refused(run(f"{words} --sign on-probe {both}"), "two outputs")
    assert empty(output)
