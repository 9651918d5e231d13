"""Measurements of a Gaussian against dense algebra, and against each other."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from ttus_opt.gaussian.conditioned import ByCovariance, ByImages, conditioned

RNG = np.random.default_rng(1)
M = 24
DATA = RNG.normal(size=M)
GROUP = np.repeat([5, 2, 9, 3], [3, 12, 1, 8])


def images(k):
    return 0.6 * np.random.default_rng(k).normal(size=(k, M))


def covariance(k):
    return np.asarray(np.eye(M) + images(k).T @ images(k))


CASES = {
    "few images": (ByImages.of(images(6), DATA), covariance(6)),
    "many images": (ByImages.of(images(40), DATA), covariance(40)),
    "covariance": (ByCovariance.of(covariance(40), DATA), covariance(40)),
    "no images": (ByImages.of(np.zeros((0, M)), DATA), np.eye(M)),
}
every = pytest.mark.parametrize(("given", "S"), CASES.values(), ids=CASES)


@every
def test_solve_is_the_dense_inverse(given, S):
    several = np.random.default_rng(2).normal(size=(M, 3))
    np.testing.assert_allclose(given.solve(several), np.linalg.solve(S, several))
    np.testing.assert_allclose(given.multipliers, np.linalg.solve(S, DATA))
    assert given.square == pytest.approx(DATA @ np.linalg.solve(S, DATA))


@every
def test_the_density_is_that_of_a_normal(given, S):
    found = given.log_density - 0.5 * M * np.log(2.0 * np.pi)
    assert found == pytest.approx(multivariate_normal(np.zeros(M), S).logpdf(DATA))
    assert given.log_determinant == pytest.approx(np.linalg.slogdet(S)[1])


@every
def test_groups_left_out_are_predicted_from_the_others(given, S):
    """By conditioning without them; also of several data at once."""
    several = np.stack([DATA, np.cos(np.arange(M))], axis=1)
    both = given.left_out(GROUP, given.solve(several))
    np.testing.assert_allclose(given.left_out(GROUP), both[:, 0], atol=1e-12)
    for number in np.unique(GROUP):
        own, rest = number == GROUP, number != GROUP
        told = np.linalg.solve(S[np.ix_(rest, rest)], several[rest])
        expected = several[own] - S[np.ix_(own, rest)] @ told
        np.testing.assert_allclose(both[own], expected, atol=1e-10)


@every
def test_what_all_others_predict_has_no_multipliers(given, S):
    own = GROUP == 2
    left = given.solve(given.data - np.where(own, given.left_out(GROUP), 0.0))
    np.testing.assert_allclose(left[own], 0.0, atol=1e-10)
    expected = np.linalg.solve(S[np.ix_(~own, ~own)], DATA[~own])
    np.testing.assert_allclose(left[~own], expected, atol=1e-10)


def test_coefficients_are_those_of_ridge_regression():
    B, given = images(6), ByImages.of(images(6), DATA)
    rows = np.vstack([B.T, np.eye(6)])
    aim = np.concatenate([DATA, np.zeros(6)])
    expected = np.linalg.lstsq(rows, aim, rcond=None)[0]
    np.testing.assert_allclose(given.coefficients(DATA), expected)
    np.testing.assert_allclose(given.spread, np.linalg.inv(rows.T @ rows))
    explained = np.eye(M) - given.solve(np.eye(M))
    np.testing.assert_allclose(given.half.T @ given.half, explained, atol=1e-12)


def test_white_data_have_the_covariance_of_white_noise():
    given = ByCovariance.of(covariance(40), DATA)
    root = given.white(covariance(40))
    np.testing.assert_allclose(given.white(root.T), np.eye(M), atol=1e-12)


@pytest.mark.parametrize(("k", "kind"), [(6, ByImages), (40, ByCovariance)])
def test_the_smaller_system_is_factorised(k, kind):
    found = conditioned(images(k), DATA)
    assert isinstance(found, kind) and len(found.factor) == min(k, M)
    np.testing.assert_allclose(found.solve(DATA), np.linalg.solve(covariance(k), DATA))
