"""The recursion against stacked least squares."""

import numpy as np
import pytest

from ttus_opt.comparators.recursive_least_squares import RecursiveLeastSquares


@pytest.mark.parametrize("weights", [np.ones(40), np.linspace(0.1, 1.0, 40)])
def test_the_recursion_is_least_squares_with_a_prior(weights):
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(40, 3)), rng.normal(size=40)
    first, spread = np.array([1.0, -1.0, 0.5]), np.array([2.0, 0.5, 1.0])
    recursion = RecursiveLeastSquares.start(first, spread, 1.0)
    for row, value, weight in zip(x, y, weights, strict=True):
        recursion.update(row, value, weight)
    root = np.sqrt(weights)
    stacked = np.vstack([np.diag(1.0 / spread), root[:, None] * x])
    target = np.concatenate([first / spread, root * y])
    batch, *_ = np.linalg.lstsq(stacked, target, rcond=None)
    np.testing.assert_allclose(recursion.estimate, batch, atol=1e-12)
    assert recursion.samples == pytest.approx(weights.sum())


def test_forgetting_weighs_old_samples_less():
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=(60, 2)), rng.normal(size=60)
    recursion = RecursiveLeastSquares.start(np.zeros(2), np.full(2, 1e4), 0.9)
    for row, value in zip(x, y, strict=True):
        recursion.update(row, value)
    root = 0.9 ** (0.5 * np.arange(59, -1, -1))
    batch, *_ = np.linalg.lstsq(root[:, None] * x, root * y, rcond=None)
    np.testing.assert_allclose(recursion.estimate, batch, atol=1e-6)
