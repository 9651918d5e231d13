"""The step along a line: the slope has nearly gone, and no step is longer than 1."""

import math

import numpy as np
import pytest

from ttus_opt.solvers.proximal.line_search import ENOUGH, MOST, along

#: Slopes of convex functions, negative at 0 and with their zero before 1
SLOPES = {
    "parabola": lambda s: s - 0.3,
    "near the start": lambda s: 1e3 * (s - 1e-3),
    "near the end": lambda s: s**9 - 0.5,
    "cosh": lambda s: math.sinh(8.0 * (s - 0.7)),
    "kink": lambda s: -1e-3 if s < 0.42 else 50.0 * (s - 0.42) + 1e-3,
    "Huber": lambda s: float(np.clip(30.0 * (s - 0.61), -1.0, 1.0)),
}


@pytest.mark.parametrize("name", SLOPES)
def test_the_slope_nearly_goes(name):
    slope, calls = SLOPES[name], []

    def counted(step):
        calls.append(step)
        return slope(step)

    step, left = along(counted, slope(0.0))
    assert 0.0 < step <= 1.0
    assert left == slope(step)
    assert abs(left) <= ENOUGH * abs(slope(0.0)) or len(calls) == MOST + 1
    assert len(calls) <= MOST + 1


def test_a_minimum_beyond_the_end_is_a_whole_step():
    assert along(lambda s: s - 2.0, -2.0) == (1.0, -1.0)


def test_a_jump_of_the_slope_is_closed_in_on():
    """Where no slope is small enough the bracket shrinks to the kink."""
    step, _ = along(lambda s: -1.0 if s < 0.37 else 1.0, -1.0)
    assert step == pytest.approx(0.37, abs=1e-3)


def test_a_straight_slope_takes_one_secant():
    calls = []

    def slope(step):
        calls.append(step)
        return step - 0.3

    along(slope, -0.3)
    assert calls == pytest.approx([1.0, 0.3])
