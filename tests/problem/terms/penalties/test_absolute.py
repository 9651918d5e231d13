"""Absolute values by hand, and soft thresholds."""

import numpy as np

from ttus_opt.problem.terms.penalties.absolute import Absolute
from ttus_opt.problem.terms.penalties.groups import Groups

PHI = Absolute()
R = np.array([0.5, -2.0, 0.0])


def test_values_and_signs():
    assert PHI.value(R) == 2.5
    np.testing.assert_array_equal(PHI.subgradient(R), [1.0, -1.0, 0.0])
    np.testing.assert_array_equal(PHI.admissible(3.0 * R), [1.0, -1.0, 0.0])
    assert PHI.gauge(R) == 2.0 and PHI.farthest(2.5) == 2.5


def test_what_is_left_of_the_resolvent_is_a_soft_threshold():
    v, step = np.array([0.7, -3.0, 1.4]), 2.0
    g, slope = PHI.resolvent(v, step)
    z = np.sign(v / step) * np.maximum(np.abs(v / step) - 1.0 / step, 0.0)
    np.testing.assert_allclose((v - g) / step, z)
    np.testing.assert_array_equal(slope.factor, [1.0, 0.0, 0.0])


def test_it_is_that_of_groups_of_one():
    one, v = Groups(1), np.random.default_rng(0).normal(0.0, 2.0, 20)
    assert one.value(v) == PHI.value(v)
    np.testing.assert_allclose(one.resolvent(v, 1.5)[0], PHI.resolvent(v, 1.5)[0])
