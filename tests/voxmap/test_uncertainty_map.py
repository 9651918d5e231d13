"""A map over the skin: what a frame looks up."""

import math

import numpy as np
import pytest

from ttus_opt.core.errors import InputError
from ttus_opt.voxmap.uncertainty_map import UncertaintyMap

THETA = np.arange(8) * np.pi / 4.0


def linear():
    z = np.linspace(0.0, 0.2, 3)
    return UncertaintyMap(THETA, z, 0.1 + np.abs(np.cos(THETA))[:, None] + z)


def test_between_places_it_is_bilinear_and_closed():
    found = linear()
    for angle, height in ((0.1, 0.03), (2 * np.pi - 0.1, 0.17), (np.pi, 0.2)):
        knots = np.append(np.abs(np.cos(THETA)), 1.0)
        expected = 0.1 + height
        expected += np.interp(angle, np.append(THETA, 2 * np.pi), knots)
        x, y = math.cos(angle), math.sin(angle)
        assert found.at(x, y, height) == pytest.approx(expected)
    assert found.at(1.0, 0.0, 9.0) == pytest.approx(found.at(1.0, 0.0, 0.2))


@pytest.mark.parametrize(
    "relative", [np.zeros((3, 8)), np.full((8, 3), -1.0), np.full((8, 3), np.nan)]
)
def test_what_is_no_map_is_refused(relative):
    with pytest.raises(InputError, match="uncertainty map"):
        UncertaintyMap(THETA, np.linspace(0.0, 1.0, 3), relative)


@pytest.mark.parametrize(
    ("theta", "z", "why"),
    [
        (THETA + 0.1, [0.0, 1.0], "angles"),
        (THETA / 2.0, [0.0, 1.0], "angles"),
        (THETA * np.nan, [0.0, 1.0], "angles"),
        (THETA, [1.0, 0.0], "heights"),
        (THETA, [0.0, np.nan], "heights"),
    ],
)
def test_places_stand_in_equal_steps(theta, z, why):
    with pytest.raises(InputError, match=f"uncertainty map needs {why}"):
        UncertaintyMap(theta, np.array(z), np.zeros((8, 2)))
