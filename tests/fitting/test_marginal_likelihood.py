"""The evidence with errors alike within a press, against dense algebra."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.stats

from tests.fitting.test_weight_criteria import three_presses
from ttus_opt.fitting.marginal_likelihood import MarginalLikelihood, MeasuredSeries
from ttus_opt.fitting.series_noise import SeriesNoise
from ttus_opt.fitting.tuning_series import TuningRows
from ttus_opt.fitting.weight_criteria import presses
from ttus_opt.problem import formulation as shelf
from ttus_opt.scene import Scene

FORCE, TORQUE, TIME = 30.0, 3.0, 0.1

#: Variance of sensor noise over that of model errors, of force and torque
SENSOR = (0.3, 2.0)

NOISE = SeriesNoise(TIME, np.array(SENSOR))


@functools.cache
def series(name: str = "eq10") -> MeasuredSeries:
    rows = TuningRows.of(shelf.load(name, three_presses()))
    return rows.series(1e3)


@functools.cache
def dense() -> tuple[np.ndarray, ...]:
    """C, what the Laplace field gives, targets and R, of rows in contact."""
    scene = three_presses()
    touching = np.flatnonzero(scene.rows.contact_points > 0)
    rows = (3 * touching[:, None] + np.arange(3)).ravel()
    D = np.vstack([scene.N.toarray(), scene.W.toarray() / scene.torque_length])
    t = np.concatenate([scene.f, scene.tau / scene.torque_length])
    n = len(scene.f)
    at = np.concatenate([rows, n + rows])
    G = np.linalg.solve(scene.L.toarray().T, D[at].T)
    u = D[at] @ np.linalg.solve(scene.L.toarray(), scene.b)
    return G.T @ G, u, t[at], _correlation(scene, touching)


def _correlation(scene: Scene, touching: np.ndarray) -> np.ndarray:
    time, press = scene.trajectory.time[touching], presses(scene)[touching]
    slow = np.exp(-np.abs(time[:, None] - time) / TIME) * (press[:, None] == press)
    own = [
        np.kron((slow + w * np.eye(len(time))) / (1.0 + w), np.eye(3)) for w in SENSOR
    ]
    return scipy.linalg.block_diag(*own)


def covariance() -> np.ndarray:
    C, _, t, R = dense()
    root = np.repeat([FORCE, TORQUE], len(t) // 2) ** -0.5
    return C + root[:, None] * R * root


@pytest.mark.slow
def test_the_evidence_is_that_of_dense_algebra() -> None:
    _, u, t, _ = dense()
    S, weights = covariance(), np.array([FORCE, TORQUE])
    found = series().evidence(weights, NOISE, scale=1.0)
    m = len(t)
    square = (t - u) @ np.linalg.solve(S, t - u)
    normal = scipy.stats.multivariate_normal(np.zeros(m), square / m * S)
    assert found.log_density == pytest.approx(normal.logpdf(t - u), abs=1.0)
    assert found.variance == pytest.approx(square / m, rel=1e-2)


def test_without_a_laplace_field_there_is_no_scale_and_the_density_stands() -> None:
    """An inner value of 0: the limit of a field that becomes small."""
    weights, own = np.array([FORCE, TORQUE]), series()
    none = replace(own, base=np.zeros_like(own.base)).evidence(weights, NOISE)
    assert none.scale == 1.0 and none.scale_error == np.inf
    small = replace(own, base=1e-9 * own.base).evidence(weights, NOISE, scale=1.0)
    assert none.log_density == pytest.approx(small.log_density, abs=1e-6)
    _, _, t, _ = dense()
    square = t @ np.linalg.solve(covariance(), t)
    assert none.variance == pytest.approx(square / len(t), rel=1e-2)


def test_the_scale_is_that_of_generalised_least_squares() -> None:
    _, u, t, _ = dense()
    S = covariance()
    found = series().evidence(np.array([FORCE, TORQUE]), NOISE)
    expected = (u @ np.linalg.solve(S, t)) / (u @ np.linalg.solve(S, u))
    assert found.scale == pytest.approx(expected, rel=1e-2)
    rest = t - expected * u
    variance = rest @ np.linalg.solve(S, rest) / len(t)
    error = np.sqrt(variance / (u @ np.linalg.solve(S, u)))
    assert found.scale_error == pytest.approx(error, rel=1e-2)


def test_a_coefficient_multiplies_the_rows_of_drag() -> None:
    rows = TuningRows.of(shelf.load("coulomb_global", three_presses()))
    assert rows.coefficient == "friction_coefficient"
    search = shelf.load("coulomb_global", three_presses()).search
    assert search is not None
    given = TuningRows.of(search.build(0.3))
    weights = np.array([FORCE, TORQUE])
    expected = given.series(1e3).evidence(weights, NOISE)
    found = series("coulomb_global").at(0.3).evidence(weights, NOISE)
    assert found.log_density == pytest.approx(expected.log_density, abs=1.0)
    assert found.scale == pytest.approx(expected.scale, rel=1e-2)


def test_frames_far_apart_are_independent() -> None:
    weights = np.array([FORCE, TORQUE])
    apart = SeriesNoise(1e-9, np.zeros(2))
    alone = series().evidence(weights, apart)
    _, u, t, _ = dense()
    C = dense()[0] + np.diag(np.repeat(1.0 / weights, len(t) // 2))
    square = (t - u) @ np.linalg.solve(C, t - u)
    at_one = series().evidence(weights, apart, scale=1.0)
    assert at_one.variance == pytest.approx(square / len(t), rel=1e-2)
    assert alone.log_density >= at_one.log_density
    noisy = series().evidence(weights, SeriesNoise(TIME, np.full(2, 1e9)), scale=1.0)
    assert noisy.log_density == pytest.approx(at_one.log_density, abs=1e-3)


def test_thinning_keeps_the_first_frame_of_every_press() -> None:
    whole = series()
    thin = whole.thinned(3)
    assert thin.frames == 6
    assert set(thin.press) == set(whole.press)
    np.testing.assert_array_equal(thin.time[::2], whole.time[[0, 4, 8]])
    np.testing.assert_array_equal(thin.place[::2], whole.place[[0, 4, 8]])
    np.testing.assert_array_equal(thin.images[:, :, ::2], whole.images[:, :, [0, 4, 8]])


@pytest.mark.parametrize("name", ["eq10", "coulomb_global"])
@pytest.mark.parametrize("scale", [None, 1.2])
def test_the_slope_is_that_of_differences(name: str, scale: float | None) -> None:
    """By the logarithms of both weights, both w, T and the coefficient."""
    likelihood, h = MarginalLikelihood(series(name)), 1e-5

    def at(x: np.ndarray) -> tuple[np.ndarray, SeriesNoise, float, float | None]:
        return np.exp(x[:2]), SeriesNoise(x[4], x[2:4]), x[5], scale

    x = np.array([np.log(FORCE), np.log(TORQUE), *SENSOR, TIME, 0.2])
    expected = [
        likelihood.evidence(*at(x + step)).log_density
        - likelihood.evidence(*at(x - step)).log_density
        for step in h * np.eye(6)
    ]
    evidence, slope = likelihood.with_slope(*at(x))
    found = [*slope.log_weights, *slope.sensor]
    found += [slope.correlation_time, slope.coefficient]
    np.testing.assert_allclose(
        found, np.array(expected) / (2.0 * h), rtol=1e-5, atol=1e-6
    )
    assert evidence == likelihood.evidence(*at(x))
    assert (slope.coefficient == 0.0) == (name == "eq10")


def test_the_coefficient_is_that_of_the_series_at_it() -> None:
    own, weights = series("coulomb_global"), np.array([FORCE, TORQUE])
    found = MarginalLikelihood(own).evidence(weights, NOISE, 0.3)
    expected = own.at(0.3).evidence(weights, NOISE)
    assert found.log_density == pytest.approx(expected.log_density, abs=1e-8)
    assert found.scale == pytest.approx(expected.scale, rel=1e-9)


@pytest.mark.parametrize("name", ["eq10", "coulomb_global"])
def test_a_condensed_basis_misses_no_more_than_it_says(name: str) -> None:
    own, weights, missing = series(name), np.array([FORCE, TORQUE]), 0.1
    few = own.condensed(weights, missing)
    assert 0 < len(few.images) < len(own.images)
    for mu in (0.0, 1.0):
        one, other = own.at(mu), few.at(mu)
        root = np.sqrt(weights)[:, None, None]
        left = (one.images * root).reshape(len(one.images), -1)
        kept = (other.images * root).reshape(len(other.images), -1)
        lost = left.T @ left - kept.T @ kept
        assert np.linalg.eigvalsh(lost).min() > -1e-8 * np.square(left).sum()
        assert np.trace(lost) <= 2.0 * (1.0 + mu**2) * missing
        both = (each.evidence(weights, NOISE).log_density for each in (one, other))
        assert abs(np.subtract(*both)) < (1.0 + mu**2) * missing
    assert len(own.condensed(1e-9 * weights, missing).images) == 1
