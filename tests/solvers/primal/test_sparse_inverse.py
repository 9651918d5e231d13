"""The factor, or one V-cycle, against dense inverses; the choice by its estimate."""

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp

from tests.kit import small_scene
from ttus_opt.problem.terms.departures import difference_rows
from ttus_opt.solvers.primal.sparse_inverse import (
    BYTES,
    ENTRY,
    MOST_BYTES,
    NUMBER,
    OPERATION,
    Estimate,
    SparseInverse,
)


def test_a_chain_is_factorised_and_a_volume_is_not():
    n = 30
    chain = sp.diags_array([-np.ones(n**3 - 1)], offsets=[1], shape=(n**3,) * 2)
    one, line = sp.eye_array(n), sp.diags_array([-np.ones(n - 1)], offsets=[1])
    line = sp.csr_array((-np.ones(n - 1), (np.arange(n - 1), np.arange(1, n))), (n, n))
    volume = sum(
        sp.kron(sp.kron(*pair), last)
        for *pair, last in ((line, one, one), (one, line, one), (one, one, line))
    )
    for upper, by_factor in ((chain, True), (volume, False)):
        Q = sp.csr_array(upper + upper.T + 7.0 * sp.eye_array(n**3))
        assert Estimate.of(Q).by_factor is by_factor


def envelope_of(Q):
    """βᵢ: from each row's first entry to its diagonal, in the order the rows are."""
    return np.array([i - int(np.flatnonzero(row)[0]) for i, row in enumerate(Q)])


def ladder(n=12):
    """Differences along two lines and between them; banded as numbered."""
    Q = 4.0 * np.eye(2 * n)
    for i in range(2 * n - 2):
        Q[i, i + 2] = Q[i + 2, i] = -1.0
    for i in range(0, 2 * n, 2):
        Q[i, i + 1] = Q[i + 1, i] = -1.0
    return Q


def test_the_estimate_is_that_of_the_narrow_envelope():
    """However the variables are numbered: the reordering finds the band again."""
    Q = ladder()
    banded = envelope_of(Q)
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(len(Q))
        shuffled = Q[np.ix_(order, order)]
        found = Estimate.of(sp.csr_array(shuffled))
        assert found.bytes < 0.5 * BYTES * envelope_of(shuffled).sum()
        assert found.bytes == pytest.approx(BYTES * banded.sum(), rel=0.35)
        assert found.multigrid == pytest.approx(ENTRY * np.count_nonzero(Q))
    # an envelope of widths β takes Σβ² operations: of a dense matrix Σ i²
    dense = Estimate.of(sp.csr_array(np.ones((30, 30))))
    i = np.arange(30.0)
    assert dense.bytes == BYTES * i.sum()
    assert dense.factor == pytest.approx(OPERATION * i @ i + NUMBER * i.sum())


def test_no_factor_is_made_that_does_not_fit_memory():
    assert Estimate(float(MOST_BYTES), 1.0, 1.0).by_factor
    assert not Estimate(MOST_BYTES + 1.0, 1.0, 1.0).by_factor
    assert not Estimate(1.0, 1.1, 1.0).by_factor


@pytest.mark.parametrize("way", ["a factor", "algebraic multigrid"])
def test_it_is_near_the_inverse(way, monkeypatch):
    if way != "a factor":
        pytest.importorskip("pyamg", reason="needs ttus-opt[reference]")
    monkeypatch.setattr(Estimate, "by_factor", property(lambda _: way == "a factor"))
    rng = np.random.default_rng(0)
    D = difference_rows(small_scene(shape=(6, 8, 6), n_poses=2).voxmap.grid)
    Q = sp.csr_array(D.T @ D + sp.diags_array(rng.uniform(0.01, 1.0, D.shape[1])))
    made = SparseInverse.of(Q)
    assert made.description == way
    inverse = np.array([made.apply(unit) for unit in np.eye(Q.shape[0])])
    assert np.abs(inverse - inverse.T).max() < 1e-10 * np.abs(inverse).max()
    ratios = scipy.linalg.eigh(
        (inverse + inverse.T) / 2, np.linalg.inv(Q.toarray()), eigvals_only=True
    )
    if way == "a factor":
        np.testing.assert_allclose(ratios, 1.0, rtol=1e-6)
    else:
        assert 0.2 < ratios.min() <= ratios.max() < 1.0 + 1e-6


def test_a_singular_matrix_is_inverted_on_its_range():
    """Differences without a ground: what is constant is nobody's, the rest is exact."""
    D = np.diff(np.eye(8), axis=0)
    Q = D.T @ D
    made, side = SparseInverse.of(sp.csr_array(Q)), D.T @ np.arange(1.0, 8.0)
    found = made.apply(side)
    np.testing.assert_allclose(Q @ found, side, atol=1e-6)
    np.testing.assert_allclose(np.diff(found), np.arange(1.0, 8.0), rtol=1e-6)
