from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ttus_opt.errors import InputError
from ttus_opt.low_rank_kernel import JITTER, ROOM, LowRankKernel

Array = NDArray[np.float64]

TOLERANCE = 1e-9


def gram(n: int, rank: int, rng: np.random.Generator, scale: float = 1.0) -> Array:
    """K of so low a rank."""
    G = rng.normal(size=(n, rank)) * scale
    return G @ G.T


def grown(K: Array, step: int, tolerance: float = TOLERANCE) -> LowRankKernel:
    """The kernel of K, a few rows at a time."""
    kernel = LowRankKernel()
    for low in range(0, len(K), step):
        rows = slice(low, min(low + step, len(K)))
        own = K[rows, rows]
        kernel.append(kernel.outlook(K[rows, kernel.pivots], own, tolerance))
    return kernel


@pytest.mark.parametrize(("n", "rank", "step"), [(5, 5, 3), (90, 17, 6), (700, 40, 6)])
def test_equals_the_dense_system(n: int, rank: int, step: int) -> None:
    rng = np.random.default_rng(n)
    K = gram(n, rank, rng)
    kernel = grown(K, step)
    assert len(kernel) == n
    # about as many columns as there is to know, whatever the number of rows
    assert rank <= kernel.rank <= 2 * rank
    R = kernel.dense()
    assert np.allclose(R @ R.T, K, atol=1e-6)
    g = rng.normal(size=n)
    assert np.allclose(kernel.solve(g), np.linalg.solve(np.eye(n) + K, g), atol=1e-6)
    x, y = rng.normal(size=kernel.rank), rng.normal(size=n)
    assert np.allclose(kernel.times(x), R @ x)
    assert np.allclose(kernel.adjoint(y), R.T @ y)


def test_outlook_is_the_schur_complement() -> None:
    rng = np.random.default_rng(1)
    K = gram(64, 20, rng)
    kernel = grown(K[:60, :60], 6)
    outlook = kernel.outlook(K[60:, kernel.pivots], K[60:, 60:], 1e-9)
    H = np.eye(64) + K
    schur = H[60:, 60:] - H[60:, :60] @ np.linalg.solve(H[:60, :60], H[:60, 60:])
    assert np.allclose(outlook.schur, schur, atol=1e-6)
    # the mean of the new rows, given values of the old ones
    d = rng.normal(size=60)
    mean = K[60:, :60] @ np.linalg.solve(H[:60, :60], d)
    assert np.allclose(kernel.adjoint(d) @ outlook.gain, mean, atol=1e-6)


@given(
    n=st.integers(1, 40),
    rank=st.integers(1, 30),
    step=st.integers(1, 7),
    start=st.integers(0, 39),
    count=st.integers(0, 12),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=60, deadline=None)
def test_rows_removed_anywhere_were_never_there(
    n: int, rank: int, step: int, start: int, count: int, seed: int
) -> None:
    start = min(start, n - 1)
    count = min(count, n - start)
    rng = np.random.default_rng(seed)
    K = gram(n + 2, rank, rng)
    kernel = grown(K[:n, :n], step)
    kernel.remove(start, count, TOLERANCE)
    kept = np.delete(np.arange(n), slice(start, start + count))
    left = K[np.ix_(kept, kept)]
    assert len(kernel) == len(kept)
    assert kernel.rank <= len(kept)
    assert np.allclose(kernel.dense() @ kernel.dense().T, left, atol=1e-4)
    g = rng.normal(size=len(kept))
    expected = np.linalg.solve(np.eye(len(kept)) + left, g)
    assert np.allclose(kernel.solve(g), expected, atol=1e-4)
    # and it grows on from there
    new = [n, n + 1]
    cross = K[np.ix_(new, kept[kernel.pivots])]
    kernel.append(kernel.outlook(cross, K[np.ix_(new, new)], TOLERANCE))
    every = np.append(kept, new)
    R = kernel.dense()
    assert np.allclose(R @ R.T, K[np.ix_(every, every)], atol=1e-4)


def test_scaling_is_that_of_the_rows() -> None:
    rng = np.random.default_rng(2)
    K = gram(30, 8, rng)
    kernel = grown(K, 3)
    kernel.scale(0.5)
    g = rng.normal(size=30)
    expected = np.linalg.solve(np.eye(30) + 0.25 * K, g)
    assert np.allclose(kernel.solve(g), expected, atol=1e-6)


def test_rows_that_nearly_depend_do_not_spoil_each_other() -> None:
    """A spectrum that decays as far as rounding, and columns known to 1e-9."""
    rng = np.random.default_rng(3)
    n = 300
    G = rng.normal(size=(n, 60)) @ np.diag(10.0 ** -np.linspace(0, 8, 60))
    K = G @ G.T
    noise = rng.normal(size=(n, n)) * 1e-9
    kernel = grown(K + noise + noise.T, 6, 1e-5)
    R = kernel.dense()
    # a row that was left out has a part of √tolerance that later pivots may share
    assert np.abs(R @ R.T - K).max() < 1e-2
    assert np.linalg.norm(kernel.adjoint(np.ones(n))) < 1e3 * np.sqrt(n)


def test_what_is_no_variance_brings_no_column() -> None:
    kernel = grown(np.diag([1.0, 1e-8, 2.0, 0.0]), 2, 1e-6)
    assert kernel.pivots.tolist() == [0, 2]
    expected = np.diag([np.sqrt(1.0 + JITTER * 1e-6), np.sqrt(2.0 + JITTER * 1e-6)])
    assert np.allclose(kernel.dense()[[0, 2]], expected)
    assert not kernel.dense()[[1, 3]].any()


def test_memory_is_that_of_the_columns() -> None:
    K = gram(2000, 10, np.random.default_rng(4))
    kernel = grown(K, 6)
    assert kernel.memory_bytes < 8 * 2000 * (2 * 10 + 2) * 1.1 + 8 * 2 * ROOM
    full = grown(np.eye(400), 6)
    assert full.rank == 400
    assert full.memory_bytes < 1.1 * 8 * (400 * 401 + 3 * 400) + 8 * 2 * ROOM
    full.remove(0, 390, 1e-9)
    assert full.memory_bytes < 8 * 4 * ROOM


def test_refusals() -> None:
    kernel = grown(gram(6, 6, np.random.default_rng(0)), 3)
    with pytest.raises(InputError, match="a right side"):
        kernel.solve(np.zeros(5))
    with pytest.raises(InputError, match="new rows"):
        kernel.outlook(np.zeros((2, 5)), np.eye(2), np.zeros(2))
    with pytest.raises(InputError, match="not within"):
        kernel.remove(4, 3, 0.0)
    assert len(kernel) == 6
