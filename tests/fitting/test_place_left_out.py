"""Weights for a place left out, against dense algebra and against draws."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from ttus_opt.fitting import place_left_out
from ttus_opt.fitting.marginal_likelihood import MeasuredSeries
from ttus_opt.fitting.place_left_out import PlaceLeftOut
from ttus_opt.fitting.series_noise import SeriesNoise

WEIGHTS = np.array([0.3, 0.2])

TIME = 2.0

NOISE = SeriesNoise(TIME, np.array([0.1, 0.3]))


@functools.cache
def series() -> MeasuredSeries:
    """Twelve frames of two presses at four places, over a basis of five fields.

    Close frames have similar images, so that one place predicts another.
    """
    rng, n = np.random.default_rng(5), 12
    time = 0.1 * np.arange(n) + np.repeat([0.0, 3.0], 6)
    smooth = np.exp(-(((np.arange(n)[:, None] - np.arange(n)) / 4.0) ** 2))
    images = np.einsum("ij,ktjc->ktic", smooth, rng.normal(size=(5, 2, n, 3)))
    empty = np.zeros((2, n, 3))
    press, place = np.repeat([0, 1], 6), np.repeat([0, 1, 2, 3], 3)
    terms = ("force", "torque")
    return MeasuredSeries(terms, images, empty, empty, time, press, place)


def flat(values: np.ndarray) -> np.ndarray:
    return values.reshape(*values.shape[:-3], -1)


def dense() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """B and Σ of weighted rows, and the place and term of every row."""
    own = series()
    B = flat(np.sqrt(WEIGHTS)[:, None, None] * own.images)
    R = np.zeros((B.shape[1], B.shape[1]))
    together = own.press[:, None] == own.press
    slow = np.exp(-np.abs(own.time[:, None] - own.time) / TIME) * together
    for term, w in enumerate(NOISE.sensor):
        at = slice(36 * term, 36 * term + 36)
        R[at, at] = np.kron((slow + w * np.eye(12)) / (1.0 + w), np.eye(3))
    place = np.tile(np.repeat(own.place, 3), 2)
    return B, R, place, np.repeat([0, 1], 36)


def residuals(shares: np.ndarray) -> np.ndarray:
    """The matrix from measurements to errors on places left out."""
    B, _, place, term = dense()
    V, out = shares[term], np.eye(B.shape[1])
    for f in range(4):
        own, rest = place == f, place != f
        M = np.eye(len(B)) + (B[:, rest] * V[rest]) @ B[:, rest].T
        out[np.ix_(own, rest)] = -B[:, own].T @ np.linalg.solve(M, B[:, rest] * V[rest])
    return out


def expected(shares: np.ndarray) -> float:
    """Squared error over all places, without that of their own noise."""
    B, R, *_ = dense()
    out = residuals(shares)
    return float(np.trace(out @ (B.T @ B + R) @ out.T) - np.trace(R))


@pytest.mark.parametrize("shares", [(0.2, 0.7), (1.0, 1.0), (0.01, 0.5)])
def test_the_error_is_that_of_dense_algebra(shares: tuple[float, float]) -> None:
    found = PlaceLeftOut.of(series(), WEIGHTS, NOISE).error(np.array(shares))
    assert found == pytest.approx(expected(np.array(shares)), rel=1e-9)


def test_the_slope_is_that_of_differences() -> None:
    places, shares, h = PlaceLeftOut.of(series(), WEIGHTS, NOISE), [0.2, 0.7], 1e-5
    error, slope = places.with_slope(np.array(shares))
    assert error == places.error(np.array(shares))
    for term, step in enumerate(h * np.eye(2)):
        up, down = (places.error(shares + sign * step) for sign in (1.0, -1.0))
        assert slope[term] == pytest.approx((up - down) / (2.0 * h), rel=1e-6)


def test_the_shares_err_least() -> None:
    found = PlaceLeftOut.of(series(), WEIGHTS, NOISE).shares()
    assert ((found > 0.02) & (found < 0.95)).all()  # a minimum inside
    least = expected(found)
    for term in range(2):
        for factor in (0.7, 1.0 / 0.7):
            moved = found.copy()
            moved[term] *= factor
            assert expected(moved) > least * (1.0 - 1e-4)


def test_draws_have_that_error() -> None:
    """Fields and errors of the stated covariances, predicted place by place."""
    (B, R, *_), rng = dense(), np.random.default_rng(0)
    shares, n = np.array([0.3, 0.6]), 20_000
    noise = np.linalg.cholesky(R) @ rng.normal(size=(len(R), n))
    data = B.T @ rng.normal(size=(len(B), n)) + noise
    mean = float(((residuals(shares) @ data) ** 2).sum(axis=0).mean())
    found = PlaceLeftOut.of(series(), WEIGHTS, NOISE).error(shares)
    assert found + np.trace(R) == pytest.approx(mean, rel=0.02)


def test_independent_frames_keep_their_weights() -> None:
    noise = SeriesNoise(1e-9, np.zeros(2))
    found = PlaceLeftOut.of(series(), WEIGHTS, noise).shares()
    np.testing.assert_allclose(found, 1.0, rtol=0.1)
    assert (found <= 1.0).all()


def test_a_single_place_keeps_the_weights() -> None:
    alone = replace(series(), place=np.zeros(12, dtype=np.int64))
    found = PlaceLeftOut.of(alone, WEIGHTS, NOISE).shares()
    np.testing.assert_array_equal(found, [1.0, 1.0])


def test_one_frame_may_stand_for_several(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of copies in quick succession, each n-th one has the same sums."""
    own, several = series(), 4

    def copied(values: np.ndarray, axis: int = 0) -> np.ndarray:
        return np.repeat(values, several, axis=axis)

    quick = copied(own.time) + 1e-6 * np.tile(np.arange(several), own.frames)
    dense_series = replace(
        own,
        images=copied(own.images, 2),
        base=copied(own.base, 1),
        target=copied(own.target, 1),
        time=quick,
        press=copied(own.press),
        place=copied(own.place),
    )
    whole = PlaceLeftOut.of(dense_series, WEIGHTS, NOISE)
    monkeypatch.setattr(place_left_out, "MOST_FRAMES", own.frames)
    few = PlaceLeftOut.of(dense_series, WEIGHTS, NOISE)
    for name in ("gram", "inner", "cross"):
        np.testing.assert_allclose(
            getattr(few, name), getattr(whole, name), rtol=1e-4, atol=1e-4
        )
