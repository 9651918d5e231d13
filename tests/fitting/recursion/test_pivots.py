from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from ttus_opt.fitting.recursion.pivots import incomplete_cholesky, replacements


def test_the_factor_is_lapacks():
    """Against dpstrf, which pivots by the largest residual variance as well."""
    rng = np.random.default_rng(0)
    G = rng.normal(size=(12, 5))
    K = G @ G.T
    factor, pivots, left = incomplete_cholesky(K, 1e-9)
    expected, order, rank, _ = lapack.dpstrf(K, tol=1e-9, lower=1)
    assert rank == len(pivots) == 5
    np.testing.assert_array_equal(pivots, order[:5] - 1)
    np.testing.assert_allclose(factor[order - 1], np.tril(expected)[:, :5], atol=1e-7)
    np.testing.assert_allclose(left, 0.0, atol=1e-7)


def test_residual_variances_are_those_of_what_is_left():
    """A third column is below the tolerance: its rows keep their variance."""
    factor, pivots, left = incomplete_cholesky(np.diag([4.0, 1e-3, 9.0]), 1e-2)
    assert pivots.tolist() == [2, 0]
    np.testing.assert_allclose(left, [0.0, 1e-3, 0.0], atol=1e-12)
    assert not factor[1].any()


def test_the_newest_of_those_that_lose_enough_replaces():
    lost = np.array([[2.0, 1.1, 0.9, 0.0], [0.0, 0.0, 0.0, 1.0]])
    residual, newest_last = np.ones(4), np.arange(4)
    # losses 4, 1.21, 0.81, 1: the last has just a quarter of the largest, and once it
    # is taken the newest of the others that lose enough
    assert replacements(lost, residual, newest_last, 1e-9) == [3, 1]
    assert replacements(lost, residual, newest_last[::-1], 1e-9) == [0, 3]


def test_rows_whose_residual_is_small_replace_nothing():
    lost = np.array([[2.0, 1.0]])
    assert replacements(lost, np.array([0.0, 1.0]), np.arange(2), 1e-6) == [1]
    assert replacements(lost, np.zeros(2), np.arange(2), 1e-6) == []
