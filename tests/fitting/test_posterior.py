"""Weighted rows against dense algebra."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ttus_opt.fitting.posterior import WeightedData, kept_rows


def test_solve_is_the_dense_inverse() -> None:
    rng = np.random.default_rng(1)
    B, values = 0.5 * rng.normal(size=(6, 80)), rng.normal(size=80)
    measured = WeightedData.of(B, values)
    dense = np.linalg.solve(np.eye(80) + B.T @ B, values)
    np.testing.assert_allclose(measured.solve(values), dense, atol=1e-9)


def test_blocks_that_touch_other_voxels_are_told() -> None:
    rows = sp.csr_array(np.eye(4)[[0, 2, 3, 1]])
    kept, missing = kept_rows(rows, np.array([0, 2]), 2)
    assert missing.tolist() == [False, True]
    np.testing.assert_array_equal(kept.toarray()[:2], np.eye(2))
