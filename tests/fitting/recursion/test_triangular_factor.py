"""Every change of a factor against a factorisation anew, by numpy."""

import numpy as np
import pytest

from ttus_opt.fitting.recursion import triangular_factor as triangle

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
