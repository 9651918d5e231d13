import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ttus_opt.fitting.recursion.low_rank_kernel import (
    JITTER,
    MORE,
    LowRankKernel,
    update,
)

TOLERANCE = 1e-9


def gram(n, rank, rng):
    """K of so low a rank."""
    G = rng.normal(size=(n, rank))
    return G @ G.T


class Rows:
    """A kernel of rows of K, and which of them it holds and has in its basis."""

    def __init__(self, K, tolerance=TOLERANCE):
        self.K, self.tolerance = K, tolerance
        self.kernel = LowRankKernel()
        self.held = np.zeros(0, dtype=np.int64)
        self.basis = np.zeros(0, dtype=np.int64)

    def projection(self, new):
        """Rows `new` of K, and their entries with what is held."""
        cross = self.kernel.coordinates(self.K[np.ix_(new, self.basis)])
        return self.kernel.project(cross, self.K[np.ix_(new, new)], self.tolerance)

    def extend(self, new):
        """Take rows `new` of K in, beside those that are held."""
        new = np.asarray(new)
        o = self.projection(new)
        self.kernel.append(o, self.K[np.ix_(new[o.chosen], self.held)])
        self.held = np.append(self.held, new)
        self.basis = np.append(self.basis, new[o.chosen])

    def shrink(self, start, count):
        self.kernel.remove(start, count)
        self.held = np.delete(self.held, slice(start, start + count))

    def settle(self):
        """Compare anew what stands for those that went; how many."""
        self.basis = self.basis[self.kernel.basis >= 0]
        new = self.kernel.settle(self.tolerance)
        if len(new):
            rows = self.held[new]
            o = self.projection(rows)
            columns = self.K[np.ix_(rows[o.chosen], self.held)]
            self.kernel.extend(o, columns, new[o.chosen])
            self.basis = np.append(self.basis, rows[o.chosen])
        assert np.array_equal(self.held[self.kernel.basis], self.basis)
        return len(new)

    @property
    def block(self):
        """K of what is held."""
        return self.K[np.ix_(self.held, self.held)]


def grown(K, step, tolerance=TOLERANCE, n=None):
    """The kernel of the first n rows of K, a few at a time."""
    rows = Rows(K, tolerance)
    n = len(K) if n is None else n
    for low in range(0, n, step):
        rows.extend(np.arange(low, min(low + step, n)))
    return rows


@pytest.mark.parametrize(("n", "rank", "step"), [(5, 5, 3), (90, 17, 6), (700, 40, 6)])
def test_equals_the_dense_system(n, rank, step):
    rng = np.random.default_rng(n)
    K = gram(n, rank, rng)
    kernel = grown(K, step).kernel
    assert len(kernel) == n
    # about as many columns as there is to know, whatever the number of rows
    assert rank <= kernel.rank <= 2 * rank
    assert np.allclose(kernel.R @ kernel.R.T, K, atol=1e-6)
    g = rng.normal(size=n)
    assert np.allclose(kernel.solve(g), np.linalg.solve(np.eye(n) + K, g), atol=1e-6)


def test_a_projection_has_the_schur_complement():
    rng = np.random.default_rng(1)
    K = gram(64, 20, rng)
    rows = grown(K, 6, n=60)
    projection = rows.projection(np.arange(60, 64))
    H = np.eye(64) + K
    schur = H[60:, 60:] - H[60:, :60] @ np.linalg.solve(H[:60, :60], H[:60, 60:])
    assert np.allclose(projection.schur, schur, atol=1e-6)
    # the mean of the new rows, given values of the old ones
    d = rng.normal(size=60)
    mean = K[60:, :60] @ np.linalg.solve(H[:60, :60], d)
    assert np.allclose(d @ rows.kernel.R @ projection.gain, mean, atol=1e-6)


@given(
    n=st.integers(1, 40),
    rank=st.integers(1, 30),
    step=st.integers(1, 7),
    start=st.integers(0, 39),
    count=st.integers(0, 12),
    settles=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=60)
def test_rows_removed_anywhere_were_never_there(
    n, rank, step, start, count, settles, seed
):
    start = min(start, n - 1)
    count = min(count, n - start)
    rng = np.random.default_rng(seed)
    rows = grown(gram(n + 2, rank, rng), step, n=n)
    rows.shrink(start, count)
    kernel, left = rows.kernel, n - count
    if settles:
        rows.settle()
        assert kernel.rank <= left
    assert len(kernel) == left
    assert np.allclose(kernel.R @ kernel.R.T, rows.block, atol=1e-4)
    g = rng.normal(size=left)
    expected = np.linalg.solve(np.eye(left) + rows.block, g)
    assert np.allclose(kernel.solve(g), expected, atol=1e-4)
    # and it grows on from there
    rows.extend([n, n + 1])
    assert np.allclose(kernel.R @ kernel.R.T, rows.block, atol=1e-4)


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
    rows = Rows(G @ G.T + noise + noise.T, 1e-6)
    kernel, compared = rows.kernel, 0
    for step in range(steps):
        rows.extend(np.arange(height * step, height * (step + 1)))
        if step >= held:
            rows.shrink(0, height)
            if kernel.is_worn:
                compared += rows.settle()
                assert not kernel.is_worn
        block, R = rows.block, kernel.R
        assert np.abs(R @ R.T - block).max() < 1e-4
        assert kernel.rank <= 1.5 * len(kernel)
        g = rng.normal(size=len(kernel))
        y = kernel.solve(g)
        # (I + R Rᵀ) y = g to rounding, whatever E went through
        error = np.abs(y + R @ (R.T @ y) - g).max()
        assert error < 1e-12 * max(1.0, block.max())
    assert 0 < compared < height * steps


def test_a_row_that_takes_all_digits_along():
    """Rows far heavier than the others, and nothing of their rounding is left."""
    K = np.diag([1e14, 1.0, 1.0, 1.0]) + 0.5
    K[0, 1:] = K[1:, 0] = 1e6
    G = np.linalg.cholesky(K)
    # the same direction once more, so that it leaves no pivot behind
    G = np.vstack([G[0], G])
    rows = grown(G @ G.T, 1)
    rows.shrink(0, 2)
    g = np.arange(1.0, 4.0)
    expected = np.linalg.solve(np.eye(3) + rows.block, g)
    assert np.allclose(rows.kernel.solve(g), expected, rtol=1e-6)


def test_scaling_is_that_of_the_rows():
    """And not that of the basis: entries of K with it are as before."""
    rng = np.random.default_rng(2)
    K = gram(36, 8, rng)
    kernel = (rows := grown(K, 3, n=30)).kernel
    kernel.scale(0.5)
    g = rng.normal(size=30)
    expected = np.linalg.solve(np.eye(30) + 0.25 * rows.block, g)
    assert np.allclose(kernel.solve(g), expected, atol=1e-6)
    scaled = kernel.coordinates(K[np.ix_(np.arange(30, 36), rows.basis)]) @ kernel.R.T
    assert np.allclose(scaled, 0.5 * K[30:, :30], atol=1e-6)


def test_rows_that_nearly_depend_do_not_spoil_each_other():
    """A spectrum that decays as far as rounding, and columns known to 1e-9."""
    rng = np.random.default_rng(3)
    n = 300
    G = rng.normal(size=(n, 60)) @ np.diag(10.0 ** -np.linspace(0, 8, 60))
    K = G @ G.T
    noise = rng.normal(size=(n, n)) * 1e-9
    R = grown(K + noise + noise.T, 6, 1e-5).kernel.R
    # a row that was left out has a part of √tolerance that later pivots may share
    assert np.abs(R @ R.T - K).max() < 1e-2
    assert np.linalg.norm(np.ones(n) @ R) < 1e3 * np.sqrt(n)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_error_of_an_entry_makes_no_variance(sign):
    """An entry of K ten times what two variances allow, as an error may leave it."""
    K = np.diag([1.0, 1e-6, 2e-4])
    K[1, 2] = K[2, 1] = sign * 1e-4
    kernel = grown(K, 1, 1e-4).kernel
    assert kernel.basis.tolist() == [0, 2]
    row = kernel.R[1]
    assert row @ row <= 1e-6 * (1.0 + 1e-9)
    assert row[1] == pytest.approx(sign * 1e-3, rel=1e-6)  # cut, and its sign kept
    assert kernel._residual.max() <= 1e-12


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_a_residual_variance_is_scaled_with_its_row(factor):
    """The entry that such an error may leave, of a row that came before."""
    K = np.diag([1.0, 1e-6, 2e-4])
    K[1, 2] = K[2, 1] = 1e-4
    rows = grown(K, 1, 1e-4, n=2)
    rows.kernel.scale(factor)
    rows.tolerance *= factor**2
    rows.K = K * factor**2
    rows.extend([2])
    assert rows.kernel.R[1] == pytest.approx([0.0, 1e-3 * factor], rel=1e-6)


def test_what_is_no_variance_brings_no_column():
    kernel = grown(np.diag([1.0, 1e-8, 2.0, 0.0]), 2, 1e-6).kernel
    assert sorted(kernel.basis.tolist()) == [0, 2]
    expected = np.diag([np.sqrt(1.0 + JITTER * 1e-6), np.sqrt(2.0 + JITTER * 1e-6)])
    assert np.allclose(kernel.R[[0, 2]], expected)
    assert not kernel.R[[1, 3]].any()


def test_memory_is_that_of_the_columns():
    K = gram(2000, 10, np.random.default_rng(4))
    kernel = grown(K, 6).kernel
    k = kernel.rank
    assert k <= 20
    most = 8 * (2000 * (k + MORE + 3) * 1.1 + 2 * k**2)
    assert kernel.memory_bytes < most
    full = grown(np.eye(400), 6)
    assert full.kernel.rank == 400
    most = 8 * (2 * 400**2 + (1.1 * 400 + MORE) ** 2 + 3 * 400)
    assert full.kernel.memory_bytes < most
    full.shrink(0, 390)
    full.settle()
    assert full.kernel.memory_bytes < 8 * (2 * 10**2 + (10 + 2 * MORE) ** 2 + 3 * 10)


@pytest.mark.parametrize("k", [1, 2, 7, 40])
def test_rows_are_added_to_a_factor(k):
    rng = np.random.default_rng(2)
    A, W = rng.normal(size=(k, k + 3)), rng.normal(size=(k, 3))
    E = np.linalg.cholesky(A @ A.T + np.eye(k))
    fuller = np.linalg.cholesky(E @ E.T + W @ W.T)
    update(E, W.copy())
    np.testing.assert_allclose(E, fuller, rtol=0, atol=1e-12 * np.abs(fuller).max())
