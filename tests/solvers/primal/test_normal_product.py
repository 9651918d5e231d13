"""MᵀC M v against dense algebra."""

import numpy as np
import pytest
import scipy.sparse as sp

from ttus_opt.solvers.primal.normal_product import add_normal_product


@pytest.mark.parametrize("kind", [np.int32, np.int64])
def test_it_is_added_and_rows_without_slope_are_left_out(kind):
    rng = np.random.default_rng(0)
    M = sp.random_array((30, 12), density=0.2, rng=rng, format="csr")
    M.indices, M.indptr = M.indices.astype(kind), M.indptr.astype(kind)
    slope = rng.uniform(size=30) * (rng.uniform(size=30) < 0.5)
    M.data[M.indptr[0] : M.indptr[1]] = np.nan  # never looked at
    slope[0] = 0.0
    v, before = rng.normal(size=12), rng.normal(size=12)
    out = before.copy()
    add_normal_product(out, M, slope, v)
    dense = M.toarray()[1:]
    expected = before + dense.T @ (slope[1:] * (dense @ v))
    np.testing.assert_allclose(out, expected, rtol=1e-13, atol=1e-13)
