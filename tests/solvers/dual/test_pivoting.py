"""Block pivoting against the one set without wrong signs, also where blocks cycle."""

import itertools

import numpy as np
import pytest

from ttus_opt.solvers.dual.solver import BlockPivoting


def wrong_signs(matrix, constant, active):
    """Where z or M z + c is negative."""
    at = np.flatnonzero(active)
    z = np.zeros(len(constant))
    z[at] = np.linalg.solve(matrix[np.ix_(at, at)], -constant[at])
    return np.asarray(np.where(active, z, matrix @ z + constant) < 0.0)


@pytest.mark.parametrize("tries", [0, 3])
@pytest.mark.parametrize("seed", range(6))
def test_it_ends_at_the_one_set_without_wrong_signs(seed, tries):
    """Nearly singular matrices, for some of which blocks alone cycle."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 3))
    matrix, constant = root @ root.T + 1e-3 * np.eye(6), rng.normal(size=6)
    right = [
        np.array(active)
        for active in itertools.product([False, True], repeat=6)
        if not wrong_signs(matrix, constant, np.array(active)).any()
    ]
    pivoting, active = BlockPivoting(tries), rng.random(6) < 0.5
    for _ in range(100):
        following = pivoting.following(active, wrong_signs(matrix, constant, active))
        if following is None:
            break
        active = following
    (only,) = right
    np.testing.assert_array_equal(active, only)
    np.testing.assert_array_equal(pivoting.best, only)


def test_all_change_while_there_are_fewer_and_the_last_alone_after_that():
    none, both = np.zeros(4, bool), np.array([True, False, True, False])
    pivoting = BlockPivoting()
    np.testing.assert_array_equal(pivoting.following(none, both), both)
    last = pivoting.following(both, both)
    np.testing.assert_array_equal(last, [True, False, False, False])
    np.testing.assert_array_equal(pivoting.best, none)
    assert pivoting.following(both, none) is None
