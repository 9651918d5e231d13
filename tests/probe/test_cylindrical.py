"""The branch-free angle against extended precision."""

import math

import numba
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from ttus_opt.probe.cylindrical import turn_angle


@numba.njit
def angle(x, y):
    return turn_angle(x, y)


@pytest.mark.parametrize(
    ("x", "y", "expected"),
    [
        (1.0, 0.0, 0.0),
        (1.0, -0.0, 0.0),
        (0.0, 1.0, math.pi / 2),
        (-1.0, 0.0, math.pi),
        (-1.0, -0.0, math.pi),
        (0.0, -1.0, 1.5 * math.pi),
        (1.0, 1.0, math.pi / 4),
        (1.0, -1e-17, 0.0),  # 2π − 1e-17 is 2π, which is 0
        (0.0, 0.0, 0.0),
    ],
)
def test_corners(x, y, expected):
    assert angle(x, y) == pytest.approx(expected, abs=1e-15)


lengths = st.floats(-10.0, 10.0).filter(lambda v: v == 0 or abs(v) > 1e-12)


@given(lengths, lengths)
def test_within_two_roundings_of_the_exact_angle(x, y):
    assume(x != 0 or y != 0)  # the origin has no angle; ours is 0
    exact = np.arctan2(np.longdouble(y), np.longdouble(x))
    if exact < 0:
        exact += 2 * np.longdouble("3.14159265358979323846264338327950288")
    found = angle(x, y)
    assert 0.0 <= found < 2.0 * math.pi
    apart = abs(np.longdouble(found) - exact)
    turn = 2.0 * math.pi
    assert apart <= 4e-16 * exact or turn - apart < 1e-15


def test_does_not_fall_across_its_seams():
    seams = np.arctan([math.sqrt(2) - 1, 1.0, math.sqrt(2) + 1])
    for seam in np.concatenate([seams, math.pi / 2 + seams, math.pi + seams]):
        around = seam + np.linspace(-1e-13, 1e-13, 2001)
        found = np.array([angle(math.cos(t), math.sin(t)) for t in around])
        assert np.diff(found).min() > -1.5e-15
