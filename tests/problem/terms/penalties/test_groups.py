"""Lengths of groups by hand, and their proximal point by a search."""

import numpy as np
import pytest
from scipy.optimize import minimize

from ttus_opt.problem.terms.penalties.groups import Groups

PHI = Groups(2)


def test_the_value_is_the_sum_of_lengths():
    assert PHI.value(np.array([3.0, 4.0, 0.0, -2.0])) == pytest.approx(7.0)
    found = PHI.subgradient(np.array([3.0, 4.0, 0.0, 0.0]))
    np.testing.assert_allclose(found, [0.6, 0.8, 0.0, 0.0])
    found = PHI.subgradient(np.array([3e-9, -4e-9, 0.0, 0.2]))
    np.testing.assert_allclose(found, [0.6, -0.8, 0.0, 1.0])
    assert PHI.gauge(np.array([3.0, 4.0, 0.0, 2.0])) == pytest.approx(5.0)
    shortened = PHI.admissible(np.array([3.0, 4.0, 0.3, 0.4]))
    np.testing.assert_allclose(shortened, [0.6, 0.8, 0.3, 0.4])


@pytest.mark.parametrize("v", [[3.0, -1.0], [0.4, 0.2]])
def test_a_group_shrinks_towards_zero(v):
    """By Moreau, (v − g)/step is the proximal point, here by a general solver."""
    step, at = 0.8, np.array(v)
    g, _ = PHI.resolvent(at, step)
    found = minimize(
        lambda z: np.hypot(*z) + 0.5 * step * np.sum((z - at / step) ** 2),
        at / step + 0.01,
        method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-14, "maxiter": 4000},
    )
    np.testing.assert_allclose((at - g) / step, found.x, atol=1e-5)


def test_outside_the_ball_only_turning_counts():
    v = np.array([3.0, 4.0])
    g, slope = PHI.resolvent(v, 1.0)
    np.testing.assert_allclose(slope.times(v), 0.0, atol=1e-15)
    across = np.array([-4.0, 3.0])
    turned = PHI.resolvent(v + 1e-6 * across, 1.0)[0] - g
    np.testing.assert_allclose(slope.times(across), turned / 1e-6, rtol=1e-5)


def test_inside_the_ball_multipliers_follow_v():
    v = np.array([0.3, -0.4])
    g, slope = PHI.resolvent(v, 1.0)
    np.testing.assert_array_equal(g, v)
    np.testing.assert_array_equal(slope.times(v), v)
