"""The outline: exact for conics, held by the plane, an ellipses from half of one."""

import numpy as np
import pytest

from ttus_opt.scan.fill import fill_smoothly, outline

N_THETA, N_Z, Z_STEP = 90, 24, 0.012
THETA = np.arange(N_THETA)[:, None] * (2 * np.pi / N_THETA)
HEIGHT = np.linspace(-0.5, 0.5, N_Z)[None, :]
ALL = np.ones((N_THETA, N_Z), dtype=bool)


def ellipse(a, b):
    r = 1 / np.sqrt((np.cos(THETA) / a) ** 2 + (np.sin(THETA) / b) ** 2)
    return np.broadcast_to(r, (N_THETA, N_Z)).copy()


def test_outline_is_exact_for_an_ellipse():
    """Of its front alone, too; off its centre a circle has linear terms."""
    truth = ellipse(0.12, 0.17)
    np.testing.assert_allclose(outline(truth, ALL), truth, rtol=1e-9)
    front = np.broadcast_to(np.cos(THETA) > -0.5, truth.shape)
    got = outline(np.where(front, truth, 9.9), front)
    np.testing.assert_allclose(got, truth, rtol=1e-6)
    beside = 0.02 * np.cos(THETA) - 0.01 * np.sin(THETA)
    radius = beside + np.sqrt(0.13**2 - 0.02**2 - 0.01**2 + beside**2) + 0.0 * truth
    np.testing.assert_allclose(outline(radius, ALL), radius, rtol=2e-3)


def test_nothing_lies_beyond_the_plane_and_it_is_touched():
    """A plane 9 cm under the axis, the back unseen: the outline reaches it."""
    seen = np.broadcast_to(np.sin(THETA) > 0.0, ALL.shape)
    down = -np.sin(THETA)
    limit = np.where(down > 0.1, 0.09 / np.maximum(down, 0.1), np.inf)
    limit = np.broadcast_to(limit, ALL.shape)
    found = outline(np.where(seen, ellipse(0.16, 0.11), 1.0), seen, limit)
    assert (found <= limit).all()
    lowest = (found * down).max(axis=0)
    np.testing.assert_allclose(lowest, 0.09, rtol=0.03)


def test_it_stays_within_half_and_twice_the_median():
    seen = np.zeros_like(ALL)
    seen[:5] = True  # next to nothing was seen
    wild = np.where(seen, np.linspace(0.05, 0.4, N_THETA)[:, None], 0.0)
    median = float(np.median(wild[seen]))
    found = outline(wild, seen)
    assert (found >= 0.5 * median).all() and (found <= 2.0 * median).all()


def test_outline_follows_a_taper_and_a_shift():
    """A cone off the axis, seen all around, then three quarters of it."""
    radius = 0.14 + 0.03 * HEIGHT
    shift = 0.02
    c = np.cos(THETA)
    truth = shift * c + np.sqrt(radius**2 - shift**2 * (1 - c**2))
    everything = np.ones(truth.shape, bool)
    assert np.abs(outline(truth, everything) - truth).max() < 0.002
    seen = np.broadcast_to(np.cos(THETA) > -0.7, truth.shape)
    got = outline(np.where(seen, truth, 9.9), seen)
    circle = np.median(truth[seen])
    assert np.abs(got - truth)[~seen].mean() < np.abs(circle - truth)[~seen].mean()


def test_what_was_seen_stays():
    """A wavy surface with small variance is returned as it is."""
    truth = ellipse(0.12, 0.17) + 0.004 * np.sin(3 * THETA) * np.cos(4 * HEIGHT)
    seen = np.ones(truth.shape, bool)
    radius, std = fill_smoothly(truth, np.full(truth.shape, 1e-10), seen, z_step=Z_STEP)
    np.testing.assert_allclose(radius, truth, atol=2e-6)
    np.testing.assert_allclose(std, 1e-5)


def test_noise_is_smoothed():
    rng = np.random.default_rng(0)
    truth = ellipse(0.12, 0.17)
    noisy = truth + 0.001 * rng.standard_normal(truth.shape)
    seen = np.ones(truth.shape, bool)
    radius, _ = fill_smoothly(noisy, np.full(truth.shape, 1e-6), seen, z_step=Z_STEP)
    assert np.std(radius - truth) < 0.8 * np.std(noisy - truth)
    assert abs((radius - truth).mean()) < 5e-5


def test_hole_is_bridged_across_the_lap():
    """A hole of 6 cm at θ = 0, where the array begins and ends."""
    truth = ellipse(0.12, 0.17) + 0.01 * HEIGHT
    arc = 0.14 * np.angle(np.exp(1j * THETA))
    seen = np.hypot(arc, (np.arange(N_Z) - 12)[None, :] * Z_STEP) > 0.03
    radius, std = fill_smoothly(
        np.where(seen, truth, 1.0), np.full(truth.shape, 1e-6), seen, z_step=Z_STEP
    )
    assert np.abs(radius - truth).max() < 0.001
    assert std[0, 12] > 3 * std[30, 12]


def test_unseen_back_stops_at_the_support():
    c = np.cos(THETA)
    with np.errstate(divide="ignore"):
        limit = np.where(c < -1e-6, -0.08 / c, np.inf)
    limit = np.broadcast_to(limit, (N_THETA, N_Z))
    truth = ellipse(0.14, 0.14)
    seen = np.broadcast_to(c > -0.4, truth.shape)
    variance = np.full(truth.shape, 1e-6)
    free, _ = fill_smoothly(truth, variance, seen, z_step=Z_STEP)
    held, _ = fill_smoothly(truth, variance, seen, z_step=Z_STEP, limit=limit)
    assert (free > limit).any()
    assert (held[~seen] <= limit[~seen] + 1e-12).all()
    np.testing.assert_allclose(held[seen], truth[seen], atol=0.004)


def test_deviation_grows_with_the_distance():
    truth = ellipse(0.14, 0.14)
    seen = np.broadcast_to(np.cos(THETA) > 0, truth.shape)
    quarter, half = N_THETA // 4 + 1, N_THETA // 2
    distance = 0.14 * np.pi / 2
    far = np.full(truth.shape, 9.0)
    for limit, (most, length) in ((None, (0.060, 0.130)), (far, (0.020, 0.045))):
        variance = np.full(truth.shape, 1e-6)
        _, std = fill_smoothly(truth, variance, seen, z_step=Z_STEP, limit=limit)
        assert (np.diff(std[quarter:half, 5]) > 0).all()
        expected = most * (1.0 - np.exp(-distance / length))
        assert std[half, 5] == pytest.approx(expected, rel=0.05)
