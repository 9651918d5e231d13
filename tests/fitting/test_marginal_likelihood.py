"""The evidence with errors alike within a press, against dense algebra."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import scipy.optimize
import scipy.stats

from tests.fitting.test_weight_criteria import three_presses
from ttus_opt.fitting.marginal_likelihood import MeasuredSeries
from ttus_opt.fitting.tuning_series import TuningRows
from ttus_opt.fitting.weight_criteria import presses
from ttus_opt.problem import formulation as shelf
from ttus_opt.scene import Scene

FORCE, TORQUE, TIME = 30.0, 3.0, 0.1


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


def _correlation(
    scene: Scene, touching: np.ndarray, memory: float = TIME
) -> np.ndarray:
    time, press = scene.trajectory.time[touching], presses(scene)[touching]
    R = np.exp(-np.abs(time[:, None] - time) / memory) * (press[:, None] == press)
    return np.kron(np.eye(2), np.kron(R, np.eye(3)))


def covariance() -> np.ndarray:
    C, _, t, R = dense()
    root = np.repeat([FORCE, TORQUE], len(t) // 2) ** -0.5
    return C + root[:, None] * R * root


@pytest.mark.slow
def test_the_evidence_is_that_of_dense_algebra() -> None:
    _, u, t, _ = dense()
    S, weights = covariance(), np.array([FORCE, TORQUE])
    found = series().evidence(weights, TIME, scale=1.0)
    m = len(t)
    square = (t - u) @ np.linalg.solve(S, t - u)
    normal = scipy.stats.multivariate_normal(np.zeros(m), square / m * S)
    assert found.log_density == pytest.approx(normal.logpdf(t - u), abs=1.0)
    assert found.variance == pytest.approx(square / m, rel=1e-2)


def test_the_scale_is_that_of_generalised_least_squares() -> None:
    _, u, t, _ = dense()
    S = covariance()
    found = series().evidence(np.array([FORCE, TORQUE]), TIME)
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
    expected = given.series(1e3).evidence(weights, TIME)
    found = series("coulomb_global").at(0.3).evidence(weights, TIME)
    assert found.log_density == pytest.approx(expected.log_density, abs=1.0)
    assert found.scale == pytest.approx(expected.scale, rel=1e-2)


def test_the_share_of_independent_frames_errs_least() -> None:
    C, _, t, _ = dense()
    weak, long = np.array([0.3, 0.1]), 2.0  # what a press shares is not told from noise
    scene = three_presses()
    R = _correlation(scene, np.flatnonzero(scene.rows.contact_points > 0), long)
    w = np.repeat(weak, len(t) // 2) ** 0.5
    B = w[:, None] * C * w

    def error(share: float) -> float:
        gain = np.linalg.solve(np.eye(len(t)) + share * B, share * B)
        left = np.eye(len(t)) - gain
        return float(np.trace(left @ B @ left.T) + np.trace(gain @ R @ gain.T))

    found = series().independent_share(weak, long)
    best = scipy.optimize.minimize_scalar(error, bounds=(1e-3, 1.0), method="bounded")
    assert 0.01 < best.x < 0.9
    assert found == pytest.approx(best.x, rel=0.02)


def test_frames_far_apart_are_independent() -> None:
    weights = np.array([FORCE, TORQUE])
    alone = series().evidence(weights, 1e-9)
    _, u, t, _ = dense()
    C = dense()[0] + np.diag(np.repeat(1.0 / weights, len(t) // 2))
    square = (t - u) @ np.linalg.solve(C, t - u)
    at_one = series().evidence(weights, 1e-9, scale=1.0)
    assert at_one.variance == pytest.approx(square / len(t), rel=1e-2)
    assert alone.log_density >= at_one.log_density
    assert series().independent_share(weights, 1e-9) == pytest.approx(1.0, abs=0.01)


def test_thinning_keeps_the_first_frame_of_every_press() -> None:
    whole = series()
    thin = whole.thinned(3)
    assert thin.frames == 6
    assert set(thin.press) == set(whole.press)
    np.testing.assert_array_equal(thin.time[::2], whole.time[[0, 4, 8]])
    np.testing.assert_array_equal(thin.images[:, :, ::2], whole.images[:, :, [0, 4, 8]])
