"""Scales from presses left out, on numbers drawn from what is stated."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from ttus_opt.fitting.posterior import MeasuredRows, kept_rows


def drawn(scale: float) -> tuple[MeasuredRows, np.ndarray]:
    """Forty presses of 20 rows, what is stated scaled."""
    rng = np.random.default_rng(0)
    B = rng.normal(size=(6, 800)) * 0.5
    misfit = scale * (B.T @ rng.normal(size=6) + rng.normal(size=800))
    return MeasuredRows.of(B, misfit), np.repeat(np.arange(40), 20)


def test_the_scale_of_what_was_drawn_is_found() -> None:
    measured, press = drawn(1.5)
    variance, method = measured.scale_of(press)
    assert method == "presses left out"
    assert np.sqrt(variance) == pytest.approx(1.5, rel=0.1)
    variance, method = measured.scale_of(0 * press)
    assert method == "likelihood"
    assert np.sqrt(variance) == pytest.approx(1.5, rel=0.1)


def test_solve_is_the_dense_inverse() -> None:
    measured, _ = drawn(1.0)
    B, values = measured.weighted, np.random.default_rng(1).normal(size=800)
    dense = np.linalg.solve(np.eye(800) + B.T @ B, values)
    np.testing.assert_allclose(measured.solve(values), dense, atol=1e-9)


def test_blocks_that_touch_other_voxels_are_told() -> None:
    rows = sp.csr_array(np.eye(4)[[0, 2, 3, 1]])
    kept, missing = kept_rows(rows, np.array([0, 2]), 2)
    assert missing.tolist() == [False, True]
    np.testing.assert_array_equal(kept.toarray()[:2], np.eye(2))
