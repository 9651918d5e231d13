"""Scales from presses left out, on numbers drawn from what is stated."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from ttus_opt.fitting.posterior import MeasuredRows, kept_rows


def drawn(scale: tuple[float, float]) -> tuple[MeasuredRows, np.ndarray, np.ndarray]:
    """Forty presses of 20 rows, 10 of each kind, noise of each kind scaled."""
    rng = np.random.default_rng(0)
    B = rng.normal(size=(6, 800)) * 0.5
    kind = np.tile([0, 1], 400)
    noise = np.array(scale)[kind] * rng.normal(size=800)
    misfit = B.T @ rng.normal(size=6) + noise
    return MeasuredRows.of(B, misfit), np.repeat(np.arange(40), 20), kind


def test_noise_of_each_kind_is_found_apart() -> None:
    measured, press, kind = drawn((1.0, 0.2))
    found = measured.calibrate(press, kind)
    assert found.method == "presses left out"
    assert np.sqrt(found.noise[0]) == pytest.approx(1.0, rel=0.1)
    assert np.sqrt(found.noise[1]) == pytest.approx(0.2, rel=0.15)
    alone = measured.calibrate(0 * press, kind)
    assert alone.method == "likelihood" and alone.noise[0] == alone.variance


def test_one_kind_has_the_noise_of_all() -> None:
    measured, press, kind = drawn((1.5, 1.5))
    found = measured.calibrate(press, 0 * kind)
    assert found.noise[0] == pytest.approx(found.variance, rel=1e-3)
    assert np.sqrt(found.variance) == pytest.approx(1.5, rel=0.1)


def test_solve_is_the_dense_inverse() -> None:
    measured, _, _ = drawn((1.0, 1.0))
    B, values = measured.weighted, np.random.default_rng(1).normal(size=800)
    dense = np.linalg.solve(np.eye(800) + B.T @ B, values)
    np.testing.assert_allclose(measured.solve(values), dense, atol=1e-9)


def test_blocks_that_touch_other_voxels_are_told() -> None:
    rows = sp.csr_array(np.eye(4)[[0, 2, 3, 1]])
    kept, missing = kept_rows(rows, np.array([0, 2]), 2)
    assert missing.tolist() == [False, True]
    np.testing.assert_array_equal(kept.toarray()[:2], np.eye(2))
