import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ttus_opt.fitting.recursion.low_rank_kernel import MORE, LowRankKernel
from ttus_opt.fitting.recursion.triangular_factor import JITTER

TOLERANCE = 1e-9


def gram(n, rank, rng, scale=1.0):
    """K of so low a rank."""
    G = rng.normal(size=(n, rank)) * scale
    return G @ G.T


def dense(kernel):
    """R with all its zeros, shape (n, k)."""
    columns = [kernel.times(column) for column in np.eye(kernel.rank)]
    return np.array(columns).reshape(kernel.rank, len(kernel)).T


def extend(kernel, K, held, new, tolerance=TOLERANCE, numbers=None):
    """Take rows `new` of K in, beside those that rows of the kernel are."""
    o = kernel.project(
        kernel.coordinates(K[np.ix_(new, held[kernel.pivots])]),
        K[np.ix_(new, new)],
        tolerance,
    )
    others = K[np.ix_(new[o.chosen], held[kernel.others])]
    kernel.append(o, others, numbers)


def shrink(kernel, K, kept, start, count, tolerance=TOLERANCE):
    """Take rows out, and compare anew what stands for them; `kept` are the others."""
    rows = kernel.remove(start, count, tolerance)
    if len(rows):
        kernel.drop(rows)
        extend(kernel, K, kept, kept[rows], tolerance, rows)


def grown(K, step, tolerance=TOLERANCE):
    """The kernel of K, a few rows at a time."""
    kernel = LowRankKernel()
    for low in range(0, len(K), step):
        rows = np.arange(low, min(low + step, len(K)))
        extend(kernel, K, np.arange(low), rows, tolerance)
    return kernel


@pytest.mark.parametrize(("n", "rank", "step"), [(5, 5, 3), (90, 17, 6), (700, 40, 6)])
def test_equals_the_dense_system(n, rank, step):
    rng = np.random.default_rng(n)
    K = gram(n, rank, rng)
    kernel = grown(K, step)
    assert len(kernel) == n
    # about as many columns as there is to know, whatever the number of rows
    assert rank <= kernel.rank <= 2 * rank
    R = dense(kernel)
    assert np.allclose(R @ R.T, K, atol=1e-6)
    g = rng.normal(size=n)
    assert np.allclose(kernel.solve(g), np.linalg.solve(np.eye(n) + K, g), atol=1e-6)
    x, y = rng.normal(size=kernel.rank), rng.normal(size=n)
    assert np.allclose(kernel.times(x), R @ x)
    assert np.allclose(kernel.adjoint(y), R.T @ y)


def test_a_projection_has_the_schur_complement():
    rng = np.random.default_rng(1)
    K = gram(64, 20, rng)
    kernel = grown(K[:60, :60], 6)
    held = kernel.coordinates(K[60:, kernel.pivots])
    projection = kernel.project(held, K[60:, 60:], 1e-9)
    H = np.eye(64) + K
    schur = H[60:, 60:] - H[60:, :60] @ np.linalg.solve(H[:60, :60], H[:60, 60:])
    assert np.allclose(projection.schur, schur, atol=1e-6)
    # the mean of the new rows, given values of the old ones
    d = rng.normal(size=60)
    mean = K[60:, :60] @ np.linalg.solve(H[:60, :60], d)
    assert np.allclose(kernel.adjoint(d) @ projection.gain, mean, atol=1e-6)


@given(
    n=st.integers(1, 40),
    rank=st.integers(1, 30),
    step=st.integers(1, 7),
    start=st.integers(0, 39),
    count=st.integers(0, 12),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=60, deadline=None)
def test_rows_removed_anywhere_were_never_there(n, rank, step, start, count, seed):
    start = min(start, n - 1)
    count = min(count, n - start)
    rng = np.random.default_rng(seed)
    K = gram(n + 2, rank, rng)
    kernel = grown(K[:n, :n], step)
    kept = np.delete(np.arange(n), slice(start, start + count))
    shrink(kernel, K, kept, start, count)
    left = K[np.ix_(kept, kept)]
    assert len(kernel) == len(kept)
    assert kernel.rank <= len(kept)
    assert np.allclose(dense(kernel) @ dense(kernel).T, left, atol=1e-4)
    g = rng.normal(size=len(kept))
    expected = np.linalg.solve(np.eye(len(kept)) + left, g)
    assert np.allclose(kernel.solve(g), expected, atol=1e-4)
    # and it grows on from there
    new = [n, n + 1]
    extend(kernel, K, kept, np.array(new))
    every = np.append(kept, new)
    R = dense(kernel)
    assert np.allclose(R @ R.T, K[np.ix_(every, every)], atol=1e-4)


@pytest.mark.parametrize("scale", [1.0, 1e3])
def test_a_window_slides_without_drift(scale):
    """R of K whose entries have an error, a spectrum that decays far, and no growth."""
    rng = np.random.default_rng(8)
    steps, height, held = 150, 3, 12
    spectrum = scale * 10.0 ** -np.linspace(0, 8, 40)
    # a spot that wanders: rows are nearly those before
    G = np.cumsum(rng.normal(size=(steps, height, 40)), axis=0).reshape(-1, 40)
    G = (G / 10.0 + 0.05 * rng.normal(size=G.shape)) * spectrum
    noise = 1e-10 * rng.normal(size=(len(G), len(G)))
    K = G @ G.T + noise + noise.T
    kernel, rows = LowRankKernel(), np.zeros(0, dtype=np.int64)
    compared = 0
    for step in range(steps):
        new = np.arange(height * step, height * (step + 1))
        extend(kernel, K, rows, new, 1e-6)
        rows = np.append(rows, new)
        if step >= held:
            rows = rows[height:]
            stand = kernel.remove(0, height, 1e-6)
            compared += len(stand)
            if len(stand):
                kernel.drop(stand)
                extend(kernel, K, rows, rows[stand], 1e-6, stand)
        R, block = dense(kernel), K[np.ix_(rows, rows)]
        assert np.abs(R @ R.T - block).max() < 1e-4
        g = rng.normal(size=len(rows))
        y = kernel.solve(g)
        # (I + R Rᵀ) y = g to rounding, whatever E went through
        error = np.abs(y + R @ (R.T @ y) - g).max()
        assert error < 1e-12 * max(1.0, block.max())
    assert 0 < compared < height * steps


def test_an_error_of_the_factor_is_gone_once_as_many_rows_went_as_are_held():
    rng = np.random.default_rng(9)
    K = gram(60, 12, rng)
    kernel = grown(K[:20, :20], 2)
    kernel._E[0] *= 1.1
    rows = np.arange(20)
    for new in range(20, 60, 2):
        extend(kernel, K, rows, np.array([new, new + 1]))
        rows = np.append(rows, [new, new + 1])[2:]
        shrink(kernel, K, rows, 0, 2)
    g = rng.normal(size=20)
    y = kernel.solve(g)
    assert np.allclose(y + K[np.ix_(rows, rows)] @ y, g, atol=1e-6)


def test_a_row_that_takes_all_digits_along():
    """Rows far heavier than the others, and nothing of their rounding is left."""
    K = np.diag([1e14, 1.0, 1.0, 1.0]) + 0.5
    K[0, 1:] = K[1:, 0] = 1e6
    G = np.linalg.cholesky(K)
    # the same direction once more, so that it leaves no pivot behind
    G = np.vstack([G[0], G])
    K = G @ G.T
    kernel = grown(K, 1)
    kept = np.arange(2, 5)
    shrink(kernel, K, kept, 0, 2)
    g = np.arange(1.0, 4.0)
    left = K[np.ix_(kept, kept)]
    assert np.allclose(kernel.solve(g), np.linalg.solve(np.eye(3) + left, g), rtol=1e-6)


def test_scaling_is_that_of_the_rows():
    rng = np.random.default_rng(2)
    K = gram(30, 8, rng)
    kernel = grown(K, 3)
    kernel.scale(0.5)
    g = rng.normal(size=30)
    expected = np.linalg.solve(np.eye(30) + 0.25 * K, g)
    assert np.allclose(kernel.solve(g), expected, atol=1e-6)


def test_rows_that_nearly_depend_do_not_spoil_each_other():
    """A spectrum that decays as far as rounding, and columns known to 1e-9."""
    rng = np.random.default_rng(3)
    n = 300
    G = rng.normal(size=(n, 60)) @ np.diag(10.0 ** -np.linspace(0, 8, 60))
    K = G @ G.T
    noise = rng.normal(size=(n, n)) * 1e-9
    kernel = grown(K + noise + noise.T, 6, 1e-5)
    R = dense(kernel)
    # a row that was left out has a part of √tolerance that later pivots may share
    assert np.abs(R @ R.T - K).max() < 1e-2
    assert np.linalg.norm(kernel.adjoint(np.ones(n))) < 1e3 * np.sqrt(n)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_error_of_an_entry_makes_no_variance(sign):
    """An entry of K ten times what two variances allow, as an error may leave it."""
    K = np.diag([1.0, 1e-6, 2e-4])
    K[1, 2] = K[2, 1] = sign * 1e-4
    kernel = grown(K, 1, 1e-4)
    assert kernel.pivots.tolist() == [0, 2]
    row = dense(kernel)[1]
    assert row @ row <= 1e-6 * (1.0 + 1e-9)
    assert row[1] == pytest.approx(sign * 1e-3, rel=1e-6)  # cut, and its sign kept
    assert kernel._residual.max() <= 1e-12


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_a_residual_variance_is_scaled_with_its_row(factor):
    """The entry that such an error may leave, of a row that came before."""
    K = np.diag([1.0, 1e-6, 2e-4])
    K[1, 2] = K[2, 1] = 1e-4
    kernel = grown(K[:2, :2], 1, 1e-4)
    kernel.scale(factor)
    K *= factor**2
    extend(kernel, K, np.arange(2), np.array([2]), 1e-4 * factor**2)
    row = dense(kernel)[1]
    assert row == pytest.approx([0.0, 1e-3 * factor], rel=1e-6)


def test_what_is_no_variance_brings_no_column():
    kernel = grown(np.diag([1.0, 1e-8, 2.0, 0.0]), 2, 1e-6)
    assert sorted(kernel.pivots.tolist()) == [0, 2]
    expected = np.diag([np.sqrt(1.0 + JITTER * 1e-6), np.sqrt(2.0 + JITTER * 1e-6)])
    assert np.allclose(dense(kernel)[[0, 2]], expected)
    assert not dense(kernel)[[1, 3]].any()


def test_memory_is_that_of_the_columns():
    K = gram(2000, 10, np.random.default_rng(4))
    kernel = grown(K, 6)
    k = kernel.rank
    assert k <= 20
    most = 8 * (2000 * (k + MORE + 3) * 1.1 + 2 * k**2)
    assert kernel.memory_bytes < most
    full = grown(np.eye(400), 6)
    assert full.rank == 400
    assert full.memory_bytes < 1.1 * 8 * (2 * 400**2 + 430 * 2 * MORE + 3 * 400)
    full.remove(0, 390, 1e-9)
    assert full.memory_bytes < 8 * (2 * 10**2 + (10 + 2 * MORE) ** 2 + 3 * 10)
