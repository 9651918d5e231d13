"""KKT violations and signs of multipliers, on one spoke of four voxels."""

import numpy as np

from ttus_opt.solvers.dual.limits import Multipliers, SpokeLimits
from ttus_opt.solvers.dual.optimality import find_violations, right_signs
from ttus_opt.solvers.dual.working_set import WorkingSet

INF = np.inf

#: Lower, upper, both and given: one of each, and links that want a fall of 1
LIMITS = SpokeLimits(
    (4, 1, 1),
    np.array([0.0, -INF, 0.0, 2.0]),
    np.array([INF, 5.0, 9.0, 2.0]),
    np.array([False, False, False, True]),
    np.array([1.0, 1.0, -INF, -INF]),
    {},
)


def working_set(bounds, links):
    return WorkingSet(np.array(bounds, dtype=np.int8), np.array(links))


def test_multipliers_are_told_with_the_right_sign():
    """A lower bound's is not positive, an upper one's and a link's not negative."""
    active = working_set([-1, 1, 0, 0], [True, True, False, False])
    signs = Multipliers(
        np.array([1e-9, -1e-9, 0.0, -3.0]), np.array([-1e-9, 2.0, 0.0, 0.0])
    )
    found = right_signs(LIMITS, active, signs)
    np.testing.assert_array_equal(found.bounds, [0.0, 0.0, 0.0, -3.0])
    np.testing.assert_array_equal(found.links, [0.0, 2.0, 0.0, 0.0])


def test_wrong_signs_and_violated_limits_are_found():
    active = working_set([-1, 0, 0, 0], [False, True, False, False])
    p = np.array([0.0, 8.0, -4.0, 2.0])
    signs = Multipliers(np.array([5.0, 0.0, 0.0, 7.0]), np.array([0.0, -2.0, 0.0, 0.0]))
    gradient = np.array([10.0, 0.0, 0.0, 0.0])
    found = find_violations(LIMITS, active, p, signs, gradient)
    # active with the wrong sign; above 5; below 0; a given value is never free
    np.testing.assert_allclose(found.bounds[:3], [0.5, 3 / 8, 0.5])
    assert found.bounds[3] == -INF
    np.testing.assert_array_equal(found.side[1:3], [1, -1])
    # the first link lacks 9 of its fall, the second one's multiplier is negative
    np.testing.assert_allclose(found.links[:2], [9 / 8, 0.2])
    assert (found.links[2:] == -INF).all()
    assert found.count == 5
    following = found.pivoted(LIMITS, active)
    np.testing.assert_array_equal(following.bounds, [0, 1, -1, 0])
    np.testing.assert_array_equal(following.links, [True, False, False, False])
