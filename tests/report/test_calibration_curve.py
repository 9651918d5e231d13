"""Curves of stated uncertainty, where errors are drawn from what is stated or wider."""

import json

import numpy as np
import pytest
from scipy.stats import norm

from ttus_opt.core.saved_results import plain
from ttus_opt.report.calibration_curve import GROUPS, LEVELS, CalibrationCurve

N = 20_000


@pytest.mark.parametrize("wider", [1.0, 2.0])
def test_shares_are_those_of_the_normal_distribution(wider):
    """Errors k times as wide lie within z with share 2Φ(z / k) − 1."""
    rng = np.random.default_rng(3)
    std = rng.uniform(0.1, 3.0, (N, 3))
    error = wider * std * rng.standard_normal((N, 3))
    found = CalibrationCurve.of((error, std), (1e-3 * error, 1e-3 * std))
    within = norm.ppf(0.5 + 0.5 * np.array(LEVELS))
    expected = 2.0 * norm.cdf(within / wider) - 1.0
    four_sigma = 4.0 * np.sqrt(0.25 / (3 * N))
    np.testing.assert_allclose(found.force, expected, atol=four_sigma)
    np.testing.assert_allclose(found.torque, found.force)
    assert found.coverage == found.force[LEVELS.index(0.95)]


def test_groups_go_from_least_to_most_stated_and_hold_their_own_errors():
    rng = np.random.default_rng(4)
    size = np.repeat(np.arange(1.0, GROUPS + 1.0), 10)
    std = rng.permutation(size)[:, None] * np.array([2.0, 1.0, 2.0]) / 3.0
    found = CalibrationCurve.of((0.5 * std, std))
    np.testing.assert_allclose(found.stated_N, np.arange(1.0, GROUPS + 1.0))
    np.testing.assert_allclose(found.error_N, 0.5 * found.stated_N)
    assert np.isnan(found.torque).all()


def test_few_frames_make_fewer_groups():
    three = np.ones((3, 3))
    assert len(CalibrationCurve.of((three, three)).stated_N) == 1
    twelve = np.ones((12, 3))
    assert len(CalibrationCurve.of((twelve, twelve)).stated_N) == 2


def test_what_is_written_comes_back():
    rng = np.random.default_rng(5)
    made = CalibrationCurve.of((rng.standard_normal((30, 3)), np.ones((30, 3))))
    again = CalibrationCurve.from_dict(json.loads(json.dumps(plain(made.as_dict()))))
    for name, values in vars(made).items():
        np.testing.assert_array_equal(getattr(again, name), values)
