"""Places left out, against dense fits without them."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from ttus_opt.fitting.weights import place_left_out
from ttus_opt.fitting.weights.place_left_out import PlaceLeftOut, criteria
from ttus_opt.fitting.weights.tuning_rows import BasisRows

WEIGHTS = np.array([20.0, 3.0])


@functools.cache
def judge(free_scale=False):
    """Rows of two terms at four places, which a field of six parts explains."""
    rng, n = np.random.default_rng(5), 24
    place = np.tile(np.repeat([4, 7, 8, 9], 3), 2)
    images = rng.normal(size=(6, 2, 4, 3)).cumsum(axis=2).reshape(6, n)
    base = 3.0 + rng.normal(size=n)
    target = 1.3 * base + rng.normal(size=6) @ images + 0.2 * rng.normal(size=n)
    term, every = np.repeat([0, 1], 12), np.full(n, 2.0)
    slope = 0.1 * images[:, ::-1], np.zeros(n)
    rows = BasisRows(images, base, target, term, place, every, slope)
    return PlaceLeftOut(rows, 2, 6.0, 1e3, 1.0, free_scale)


def refitted(scale, coefficient=0.0):
    """The errors of every place by a fit without it."""
    rows = judge().rows.at(coefficient)
    W, out = WEIGHTS[rows.term] * rows.every, np.empty(len(rows.target))
    misfit = rows.target - scale * rows.base
    for place in np.unique(rows.place):
        own = rows.place == place
        K, w = rows.images[:, ~own], W[~own]
        c = np.linalg.solve(np.eye(6) + (K * w) @ K.T, (K * w) @ misfit[~own])
        out[own] = misfit[own] - c @ rows.images[:, own]
    return out


@pytest.mark.parametrize("coefficient", [0.0, 0.6])
def test_errors_are_those_of_fits_without_the_place(coefficient):
    found = judge().predicted(WEIGHTS, coefficient)
    assert (found.scale, found.scale_error) == (1.0, 0.0)
    np.testing.assert_allclose(found.errors, refitted(1.0, coefficient), rtol=1e-8)


def test_the_scale_is_that_of_generalised_least_squares():
    """By dense algebra; outside its range, or with a large error, it is 1."""
    found, rows = judge(True).predicted(WEIGHTS), judge().rows
    covariance = np.diag(1.0 / (WEIGHTS[rows.term] * rows.every))
    precision = np.linalg.inv(covariance + rows.images.T @ rows.images)
    bend = rows.base @ precision @ rows.base
    scale = rows.base @ precision @ rows.target / bend
    assert found.scale == pytest.approx(scale)
    off = rows.target - scale * rows.base
    # three rows of a frame and term: one frame per place here
    error = np.sqrt(off @ precision @ off / len(off) / bend)
    assert found.scale_error == pytest.approx(error)
    assert abs(scale - 1.3) < 3.0 * error
    np.testing.assert_allclose(found.errors, refitted(found.scale), rtol=1e-7)
    for target in (5.0 * rows.target, np.random.default_rng(0).normal(size=24)):
        kept = replace(judge(True), rows=replace(rows, target=target))
        assert kept.predicted(WEIGHTS).scale == 1.0
        assert np.isnan(kept.predicted(WEIGHTS).scale_error)


def test_the_density_counts_places_not_rows():
    errors, rows = refitted(1.0), judge().rows
    expected = [-2.0 * np.log(np.mean(errors[rows.term == t] ** 2)) for t in (0, 1)]
    assert judge().log_density(WEIGHTS) == pytest.approx(sum(expected))


def test_no_other_hyperparameters_are_more_likely():
    steps, spread = judge().best()

    def log_posterior(steps):
        density = judge().log_density(*judge().values(steps))
        return float(density - 0.5 * steps @ steps)

    best = log_posterior(steps)
    for move in (*np.eye(3), *-np.eye(3)):
        assert log_posterior(steps + 0.5 * move) < best + 0.1
    for i, move in enumerate(0.02 * np.eye(len(steps))):
        fall = 2.0 * best - log_posterior(steps + move) - log_posterior(steps - move)
        assert spread[i] == pytest.approx((max(fall / 0.02**2, 0.25)) ** -0.5, rel=0.05)


def test_values_are_signal_ratio_and_coefficient():
    weights, coefficient = judge().values(np.array([0.5, -1.0, 0.8]))
    signal, ratio = place_left_out.SIGNAL, place_left_out.RATIO
    first = signal[0] * np.exp(0.5 * signal[1]) / 6.0
    np.testing.assert_allclose(weights, [first, first * np.exp(-ratio[1])])
    assert coefficient == pytest.approx(0.8 * place_left_out.COEFFICIENT)
    weights, coefficient = judge().values(np.array([6.0, 6.0, -1.0]))
    np.testing.assert_allclose(weights, 1e3 / 6.0)  # the basis bears no more
    assert coefficient == 0.0
    assert judge().values(np.array([0.0, 0.0, 9.0]))[1] == 1.0


def test_the_search_may_start_at_given_weights():
    """And then does no worse than these."""
    given = np.array([90.0, 0.02])
    steps, _ = judge().best([given])

    def log_posterior(steps):
        return judge().log_density(*judge().values(steps)) - 0.5 * float(steps @ steps)

    start = judge()._steps(given, 3)
    np.testing.assert_allclose(judge().values(start)[0], given)
    assert log_posterior(steps) >= log_posterior(start)


def test_criteria_are_those_of_dense_algebra():
    rows = judge().rows
    root = np.sqrt(WEIGHTS[rows.term] * rows.every)
    found, m = criteria(rows, root), len(root)
    covariance = np.diag(root**-2) + rows.images.T @ rows.images
    misfit = rows.target - rows.base
    square = misfit @ np.linalg.solve(covariance, misfit)
    normal = multivariate_normal(np.zeros(m), covariance * square / m)
    assert found["log_evidence"] == pytest.approx(normal.logpdf(misfit))
    # ‖(I − H) y‖² over (tr(I − H))², H = K (K + R)⁻¹, in units of the noise's mean
    rest = np.linalg.inv(covariance) / root / root[:, None]
    y = root * misfit
    unit = np.exp(2.0 * np.log(root).mean())
    expected = m * np.sum((rest @ y) ** 2) / np.trace(rest) ** 2 / unit
    assert found["gcv"] == pytest.approx(expected)
    first, off = rows.term == 0, refitted(1.0)
    forces = rows.target[first], (rows.target - off)[first]
    told, predicted = (np.linalg.norm(f.reshape(-1, 3), axis=1) for f in forces)
    assert found["left_out_force_error"] == pytest.approx(
        np.abs(told - predicted).mean()
    )


def test_without_rows_there_is_nothing_to_tell():
    none = np.zeros(0)
    rows = BasisRows(np.zeros((0, 0)), none, none, none.astype(int), none, none)
    assert np.isnan(list(criteria(rows, none).values())).all()
