"""Every change of a packed factor against a factorisation anew, by numpy."""

from __future__ import annotations

import numpy as np
import pytest

from ttus_opt.core.arrays import Array
from ttus_opt.fitting.recursion import packed_triangle as triangle

SIZES = [1, 2, 7, 40]


def factor(k: int, seed: int = 0) -> Array:
    """A lower triangle with a positive diagonal."""
    A = np.random.default_rng(seed).normal(size=(k, k + 3))
    return np.linalg.cholesky(A @ A.T + np.eye(k))


def close(found: Array, expected: Array) -> None:
    scale = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * scale)


@pytest.mark.parametrize("k", SIZES)
def test_packing_and_solving(k: int) -> None:
    L, rng = factor(k), np.random.default_rng(1)
    E = triangle.packed(L)
    assert len(E) == triangle.packed_size(k)
    np.testing.assert_array_equal(triangle.unpacked(E, k), L)
    x, out = rng.normal(size=k), np.empty(k)
    triangle.times(E, x, out)
    close(out, L @ x)
    start = rng.normal(size=k)
    out = start.copy()
    triangle.add_adjoint(E, x, out)
    close(out, start + L.T @ x)
    rows = rng.normal(size=(3, k))
    solved = rows.copy()
    triangle.forward(E, solved)
    close(solved @ L.T, rows)
    y = x.copy()
    triangle.backward(E, y)
    close(L.T @ y, x)


@pytest.mark.parametrize("k", SIZES)
def test_rows_put_in_and_taken_out(k: int) -> None:
    L, W = factor(k), np.random.default_rng(2).normal(size=(k, 3))
    E = triangle.packed(L)
    triangle.update(E, W.copy())
    fuller = np.linalg.cholesky(L @ L.T + W @ W.T)
    close(triangle.unpacked(E, k), fuller)
    assert triangle.downdate(E, np.ascontiguousarray(W.T))
    close(triangle.unpacked(E, k), L)


def test_a_row_that_leaves_too_few_digits_is_told() -> None:
    """What goes takes all but 1e-5, then all but 1e-7 of what is known of it."""
    L = factor(6)
    w = L[:, 0] / np.linalg.norm(np.linalg.solve(L, L[:, 0]))
    for left, enough in ((1e-5, True), (1e-7, False)):
        gone = np.sqrt(1.0 - left) * w[None]
        assert triangle.downdate(triangle.packed(L), gone.copy()) == enough


@pytest.mark.parametrize("q", [0, 3, 6])
def test_a_row_is_deleted_and_all_that_goes_with_it_is_turned(q: int) -> None:
    k, rng = 7, np.random.default_rng(3)
    C, M = factor(k, 4), factor(k, 5)
    packed, E = triangle.packed(C), triangle.packed(M)
    N = rng.normal(size=(k, 2 * triangle.TILE + 5))
    turned = N.copy()
    cosines, sines = np.empty(k), np.empty(k)
    triangle.delete_row(packed, k, q, cosines, sines)
    triangle.rotate_rows(turned, k, q, cosines, sines)
    triangle.rotate_factor(E, k, q, cosines, sines)
    rest = np.delete(C, q, axis=0)
    shorter = triangle.unpacked(packed, k - 1)
    close(shorter @ shorter.T, rest @ rest.T)
    assert (np.diagonal(shorter) > 0.0).all()
    # the same turn G of all: rest G = (shorter, 0), Gᵀ N and Gᵀ M Mᵀ G
    G = turned @ np.linalg.pinv(N)
    close(rest @ G.T, np.hstack([shorter, np.zeros((k - 1, 1))]))
    close(G @ G.T, np.eye(k))
    found = triangle.unpacked(E, k)
    close(found @ found.T, G @ M @ M.T @ G.T)
    assert (np.diagonal(found) > 0.0).all()
