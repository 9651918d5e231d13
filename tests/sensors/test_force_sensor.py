"""Three statements of a sensor, each checked."""

import numpy as np
import pytest

from tests.kit import InputError, refuses
from ttus_opt.sensors.force_sensor import ForceSensor


def test_the_statements_are_three():
    told = ForceSensor(np.eye(3), np.array([0, 0, 0.1]), "by-probe").statements()
    assert told == {
        "axes": np.eye(3).tolist(),
        "point": [0, 0, 0.1],
        "sign": "by-probe",
    }


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"axes": np.diag([1.0, 1, -1])}, "axes of the sensor"),
        ({"axes": np.eye(4)}, r"\(3, 3\)"),
        ({"axes": np.full((3, 3), np.nan)}, "axes of the sensor"),
        ({"point": np.array([0, 0, 80.0])}, "millimetres"),
        ({"point": np.array([0, 0, np.nan])}, "millimetres"),
        ({"sign": "minus"}, "one of on-probe, by-probe"),
    ],
)
def test_statements_that_are_none(given, words):
    refuses(InputError, words, ForceSensor, **given)
