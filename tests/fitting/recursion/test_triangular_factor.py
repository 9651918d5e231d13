"""Every change of a factor against a factorisation anew, by numpy."""

import numpy as np
import pytest
from scipy.linalg import lapack

from ttus_opt.fitting.recursion import triangular_factor as triangle
from ttus_opt.fitting.recursion.triangular_factor import (
    incomplete_cholesky,
    replacements,
)

SIZES = [1, 2, 7, 40]


def factor(k, seed=0):
    """A lower triangle with a positive diagonal."""
    A = np.random.default_rng(seed).normal(size=(k, k + 3))
    return np.linalg.cholesky(A @ A.T + np.eye(k))


def close(found, expected):
    scale = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * scale)


@pytest.mark.parametrize("k", SIZES)
def test_rows_are_added(k):
    E, W = factor(k), np.random.default_rng(2).normal(size=(k, 3))
    fuller = np.linalg.cholesky(E @ E.T + W @ W.T)
    triangle.update(E, W.copy())
    close(E, fuller)


@pytest.mark.parametrize("q", [0, 3, 6])
def test_a_row_is_deleted_and_all_that_goes_with_it_is_turned(q):
    k, rng = 7, np.random.default_rng(3)
    C, N = factor(k, 4), rng.normal(size=(k, 2 * triangle.TILE + 5))
    turned, rest = N.copy(), np.delete(C, q, axis=0)
    cosines, sines = np.empty(k), np.empty(k)
    triangle.delete_row(C, q, cosines, sines)
    triangle.rotate_rows(turned, k, q, cosines, sines)
    shorter = C[:-1, :-1]
    close(shorter @ shorter.T, rest @ rest.T)
    assert (np.diagonal(shorter) > 0.0).all()
    # the same turn G of both: rest G = (shorter, 0), and Gᵀ N
    G = turned @ np.linalg.pinv(N)
    close(rest @ G.T, np.hstack([shorter, np.zeros((k - 1, 1))]))
    close(G @ G.T, np.eye(k))


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
