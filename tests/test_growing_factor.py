from __future__ import annotations

from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from ttus_opt import growing_factor
from ttus_opt.errors import InputError, NumericalError
from ttus_opt.growing_factor import CHUNK, GrowingFactor

Array = NDArray[np.float64]


def spd(n: int, rng: np.random.Generator, scale: float = 1.0) -> Array:
    """I + K with K of low rank, as measurements make it."""
    G = rng.normal(size=(n, n // 2 + 1)) * scale
    return np.eye(n) + G @ G.T


def grown(H: Array, step: int) -> GrowingFactor:
    """The factor of H, a few rows at a time."""
    factor = GrowingFactor()
    for low in range(0, len(H), step):
        high = min(low + step, len(H))
        reduced = factor.forward(H[low:high, :low])
        factor.append(reduced, H[low:high, low:high] - reduced @ reduced.T)
    return factor


def without(H: Array, start: int, count: int) -> Array:
    kept = np.delete(np.arange(len(H)), slice(start, start + count))
    return H[np.ix_(kept, kept)]


@pytest.mark.parametrize(("n", "step"), [(5, 3), (2 * CHUNK + 19, 6), (CHUNK, 3)])
def test_equals_the_batch_factorisation(n: int, step: int) -> None:
    rng = np.random.default_rng(n)
    H = spd(n, rng)
    factor = grown(H, step)
    F = np.linalg.cholesky(H)
    assert np.allclose(factor.dense(), F, rtol=0, atol=1e-10 * np.abs(F).max())
    g = rng.normal(size=(4, n))
    forward = solve_triangular(F, g.T, lower=True).T
    assert np.allclose(factor.forward(g), forward, atol=1e-10)
    backward = solve_triangular(F, g[0], lower=True, trans=1)
    assert np.allclose(factor.backward(g[0]), backward, atol=1e-10)


@given(
    n=st.integers(1, 40),
    step=st.integers(1, 7),
    start=st.integers(0, 39),
    count=st.integers(0, 12),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=60, deadline=None)
def test_rows_removed_anywhere_were_never_there(
    n: int, step: int, start: int, count: int, seed: int
) -> None:
    start = min(start, n - 1)
    count = min(count, n - start)
    rng = np.random.default_rng(seed)
    H = spd(n, rng)
    # small chunks, so that every boundary is crossed
    with patch.object(growing_factor, "CHUNK", 8):
        factor = grown(H, step)
        g = rng.normal(size=(3, n))
        assert np.allclose(np.linalg.cholesky(H) @ factor.forward(g).T, g.T, atol=1e-8)
        y = factor.backward(g[0])
        assert np.allclose(np.linalg.cholesky(H).T @ y, g[0], atol=1e-8)
        factor.remove(start, count)
        left = without(H, start, count)
        assert len(factor) == n - count
        F = factor.dense()
        assert np.allclose(F @ F.T, left, atol=1e-10 * np.abs(H).max())
        assert (np.diag(F) > 0.0).all()
        # and it grows on from there
        cross = rng.normal(size=(2, len(left)))
        bordered = np.block([[left, cross.T], [cross, 1e3 * np.eye(2)]])
        reduced = factor.forward(cross)
        factor.append(reduced, 1e3 * np.eye(2) - reduced @ reduced.T)
        F = factor.dense()
        assert np.allclose(F @ F.T, bordered, atol=1e-9 * np.abs(bordered).max())


def test_append_then_truncate_is_identity_bit_for_bit() -> None:
    rng = np.random.default_rng(3)
    H = spd(CHUNK + 12, rng)
    factor = grown(H[:CHUNK, :CHUNK], 6)
    before = factor.dense()
    reduced = factor.forward(H[CHUNK:, :CHUNK])
    factor.append(reduced, H[CHUNK:, CHUNK:] - reduced @ reduced.T)
    factor.truncate(CHUNK)
    assert np.array_equal(factor.dense(), before)
    assert factor.memory_bytes == CHUNK * CHUNK * 8


@pytest.mark.parametrize("fade", [0.0, 0.3, 1.0])
def test_faded_scales_k(fade: float) -> None:
    H = spd(50, np.random.default_rng(1))
    F = grown(H, 4).faded(fade).dense()
    assert np.allclose(F @ F.T, np.eye(50) + fade * (H - np.eye(50)), atol=1e-11)
    assert len(GrowingFactor().faded(fade)) == 0


def test_large_weights_lose_no_definiteness() -> None:
    rng = np.random.default_rng(5)
    H = spd(60, rng, scale=1e5)  # I + K with K up to 1e12
    factor = grown(H, 6)
    for _ in range(9):
        factor.remove(0, 6)
    F = factor.dense()
    left = H[54:, 54:]
    assert np.allclose(F @ F.T, left, rtol=1e-10, atol=1e-12 * np.abs(left).max())


def test_memory_is_half_a_square() -> None:
    factor = GrowingFactor()
    n = 5 * CHUNK
    for start in range(0, n, CHUNK):
        factor.append(np.zeros((CHUNK, start)), np.eye(CHUNK))
    assert factor.memory_bytes <= 8 * (n * n / 2 + n * CHUNK / 2)


def test_refusals() -> None:
    factor = grown(spd(6, np.random.default_rng(0)), 3)
    with pytest.raises(InputError, match="right sides"):
        factor.forward(np.zeros((2, 5)))
    with pytest.raises(InputError, match="right sides"):
        factor.backward(np.zeros((1, 6)))
    with pytest.raises(InputError, match="new rows"):
        factor.append(np.zeros((2, 5)), np.eye(2))
    with pytest.raises(InputError, match="size must lie"):
        factor.truncate(7)
    with pytest.raises(InputError, match="not within"):
        factor.remove(4, 3)
    with pytest.raises(InputError, match="between 0 and 1"):
        factor.faded(1.1)
    with pytest.raises(NumericalError, match="not positive definite"):
        factor.append(np.zeros((1, 6)), -np.eye(1))
    assert len(factor) == 6


def test_cores_share_a_long_forward_substitution() -> None:
    """More rows than are worth sharing, and a last chunk that is no multiple of 4."""
    n, m = 1551, 6
    rng = np.random.default_rng(2)
    B = rng.normal(size=(n, 40)) / 6.0
    factor = GrowingFactor()
    root = np.linalg.cholesky(np.eye(n) + B @ B.T)
    for start in range(0, n, 3):
        own = slice(start, start + 3)
        corner = root[own, own] @ root[own, own].T
        factor.append(root[own, :start], corner)
    g = rng.normal(size=(m, n))
    expected = solve_triangular(root, g.T, lower=True).T
    np.testing.assert_allclose(factor.forward(g), expected, atol=1e-11)
