"""Correlated errors of presses, made independent."""

from __future__ import annotations

import numpy as np
import pytest

from ttus_opt.fitting.series_noise import PressTimes, SeriesNoise

#: Two presses; the second one is unevenly timed
TIMES = np.array([0.0, 0.1, 0.2, 5.0, 5.05, 5.3, 5.35])
PRESS = np.array([2, 2, 2, 4, 4, 4, 4])

NOISE = SeriesNoise(0.2, np.array([0.3, 2.0]))


def correlation(noise: SeriesNoise, term: int) -> np.ndarray:
    return noise.correlation(TIMES, PRESS, term)


def test_presses_are_runs_of_frames() -> None:
    first, second = PressTimes.of(TIMES, PRESS)
    assert (first.frames, second.frames) == (slice(0, 3), slice(3, 7))
    np.testing.assert_allclose(first.apart[0], [0.0, 0.1, 0.2])
    assert not PressTimes.of(TIMES[:0], PRESS[:0])


@pytest.mark.parametrize("term", [0, 1])
def test_the_correlation_is_of_two_processes(term: int) -> None:
    R, w = correlation(NOISE, term), NOISE.sensor[term]
    np.testing.assert_allclose(np.diag(R), 1.0)
    assert R[0, 1] == pytest.approx(np.exp(-0.1 / 0.2) / (1.0 + w))
    assert R[4, 6] == pytest.approx(np.exp(-0.3 / 0.2) / (1.0 + w))
    assert not R[:3, 3:].any()


@pytest.mark.parametrize("term", [0, 1])
def test_a_filter_whitens_and_derivatives_are_those_of_differences(term: int) -> None:
    h, step = 1e-6, 1e-6 * np.eye(2)[term]
    longer, shorter = (SeriesNoise(0.2 + s * h, NOISE.sensor) for s in (1, -1))
    louder, softer = (SeriesNoise(0.2, NOISE.sensor + s * step) for s in (1, -1))
    for press in PressTimes.of(TIMES, PRESS):
        one, at = NOISE.whitening(press)[term], press.frames
        R = correlation(NOISE, term)[at, at]
        np.testing.assert_allclose(
            one.filter @ R @ one.filter.T, np.eye(len(R)), atol=1e-12
        )
        for found, up, down in (
            (one.by_time, longer, shorter),
            (one.by_sensor, louder, softer),
        ):
            expected = (correlation(up, term) - correlation(down, term))[at, at]
            np.testing.assert_allclose(found, expected / (2.0 * h), atol=1e-8)


def test_without_a_slow_part_frames_are_independent() -> None:
    white = SeriesNoise(1e-9, np.zeros(2))
    for press in PressTimes.of(TIMES, PRESS):
        one = white.whitening(press)[0]
        np.testing.assert_allclose(one.filter, np.eye(len(press.apart)))
        assert not one.by_time.any()
