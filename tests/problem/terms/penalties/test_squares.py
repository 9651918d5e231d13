"""Squares by hand; Huber's penalty with a wide threshold is the same."""

import numpy as np

from ttus_opt.problem.terms.penalties.huber import Huber
from ttus_opt.problem.terms.penalties.squares import Squares

PHI, R = Squares(), np.array([0.5, -2.0, 1.0])


def test_values_by_hand():
    assert PHI.value(R) == 5.25
    np.testing.assert_array_equal(PHI.subgradient(R), [1.0, -4.0, 2.0])
    # sup g r − r² lies at r = g/2
    assert PHI.conjugate(2.0 * R) == PHI.value(R)
    g, _ = PHI.resolvent(R, 2.0)
    np.testing.assert_allclose(g, PHI.subgradient((R - g) / 2.0))


def test_huber_without_a_kink_is_the_same():
    wide = Huber(1e3)
    assert wide.value(R) == PHI.value(R)
    for step in (0.1, 10.0):
        g, slope = PHI.resolvent(R, step)
        again, other = wide.resolvent(R, step)
        np.testing.assert_array_equal(g, again)
        np.testing.assert_array_equal(slope.factor, other.factor)
