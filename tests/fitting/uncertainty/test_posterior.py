"""Weighted rows against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from ttus_opt.fitting.uncertainty.posterior import WeightedData, kept_rows


def test_solve_is_the_dense_inverse() -> None:
    rng = np.random.default_rng(1)
    B, values = 0.5 * rng.normal(size=(6, 80)), rng.normal(size=80)
    measured = WeightedData.of(B, values)
    dense = np.linalg.solve(np.eye(80) + B.T @ B, values)
    np.testing.assert_allclose(measured.solve(values), dense, atol=1e-9)
    sign, size = np.linalg.slogdet(np.eye(80) + B.T @ B)
    assert sign == 1.0 and measured.log_determinant == pytest.approx(size)


def test_blocks_that_touch_other_voxels_are_told() -> None:
    for voxels in (4, 9):  # fewer blocks than voxels, or about as many
        rows = sp.csr_array(np.eye(voxels)[[0, 2, 3, 1, 2, 0]])
        kept, missing = kept_rows(rows, np.array([0, 2]), 2)
        assert missing.tolist() == [False, True, False]
        np.testing.assert_array_equal(kept.toarray()[:2], np.eye(2))
        np.testing.assert_array_equal(kept.toarray()[4:], np.eye(2)[::-1])
