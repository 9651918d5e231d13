"""Huber's penalty by hand: where squares end, and that nothing jumps there."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from ttus_opt.problem.terms.penalties.huber import Huber

PHI = Huber(0.5)


def test_squares_up_to_the_threshold_and_straight_lines_beyond():
    assert PHI.value(np.array([0.3])) == pytest.approx(0.09)
    assert PHI.value(np.array([-2.0])) == pytest.approx(2 * 0.5 * 2.0 - 0.25)
    assert PHI.value(np.array([0.3, -2.0])) == pytest.approx(0.09 + 1.75)
    inner, outer = (PHI.value(np.array([0.5 + s])) for s in (-1e-9, 1e-9))
    assert outer - inner == pytest.approx(2e-9, rel=1e-3)
    np.testing.assert_array_equal(PHI.subgradient(np.array([0.3, -2.0])), [0.6, -1.0])


@pytest.mark.parametrize("g", [-1.0, -0.4, 0.0, 0.9])
def test_the_conjugate_is_a_supremum(g):
    """Sup g r − φ(r), by a search."""
    found = minimize_scalar(
        lambda r: PHI.value(np.array([r])) - g * r, bounds=(-9.0, 9.0), method="bounded"
    )
    assert PHI.conjugate(np.array([g])) == pytest.approx(-found.fun, abs=1e-6)


def test_no_residual_of_a_value_is_longer():
    """In one residual the bound is met with equality."""
    r = np.array([3.0])
    assert PHI.farthest(PHI.value(r)) == pytest.approx(3.0)


def test_a_gauge_of_one_is_the_largest_multiplier():
    assert PHI.gauge(np.array([0.2, -1.0])) == 1.0
    assert PHI.gauge(np.array([3.0])) == 3.0
    assert PHI.gauge(np.array([0.25])) == 0.25
