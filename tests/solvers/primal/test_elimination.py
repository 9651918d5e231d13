"""Schur complements: chains walked by hand, and their joints, beside algebra."""

import numpy as np
import pytest
import scipy.sparse as sp

from ttus_opt.solvers.primal.elimination import factor, without_chains


def _differences(n, edges):
    """A graph's Laplacian of uneven weights, and a diagonal."""
    rows = np.zeros((len(edges), n))
    for row, (a, b) in zip(rows, edges, strict=True):
        row[a], row[b] = -1.0, 1.0
    weights = np.linspace(0.5, 2.0, len(edges))
    return np.asarray(rows.T @ np.diag(weights) @ rows + np.diag(np.arange(1.0, n + 1)))


@pytest.mark.parametrize(
    ("edges", "kept", "joints"),
    [
        ([(0, 1), (1, 2), (2, 3), (3, 4)], [0, 4], []),  # a chain
        ([(0, 1), (1, 2), (2, 3), (3, 4)], [2], []),  # two that end nowhere
        ([(0, 1), (1, 2), (2, 3), (3, 0), (4, 5)], [0], []),  # from a voxel to itself
        ([(0, 1), (1, 2), (0, 3), (3, 2)], [0, 2], []),  # two side by side
        ([(0, 2), (1, 2), (2, 3), (3, 4)], [0, 1, 4], [2]),  # joined where none is kept
        ([(0, 1), (1, 2), (2, 0), (2, 3), (3, 4)], [4], [2]),
        ([(0, 1)], [0, 1], []),  # nothing to eliminate
    ],
)
def test_it_is_the_schur_complement(edges, kept, joints):
    whole, at = _differences(6, edges), np.isin(np.arange(6), kept)
    left, ends = without_chains(sp.csr_array(whole), at)
    assert np.flatnonzero(ends).tolist() == sorted(kept + joints)
    A, B, C = whole[ends][:, ends], whole[ends][:, ~ends], whole[~ends][:, ~ends]
    expected = A - B @ np.linalg.solve(C, B.T)
    np.testing.assert_allclose(left.toarray(), expected, rtol=1e-12, atol=1e-14)
    side = np.linspace(1.0, 2.0, len(left.toarray()))
    found = factor(left).solve(side)
    np.testing.assert_allclose(found, np.linalg.solve(expected, side), rtol=1e-12)
