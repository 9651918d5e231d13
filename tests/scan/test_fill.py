"""The outline: exact for conics, held by the plane, an ellipses from half of one."""

import numpy as np
import pytest

from ttus_opt.scan.fill import fill_smoothly, outline

SPOKES, HEIGHTS = 72, 7
ANGLES = np.arange(SPOKES)[:, None] * (2 * np.pi / SPOKES)
ALL = np.ones((SPOKES, HEIGHTS), dtype=bool)


def ellipses(a=0.16, b=0.11):
    radius = 1.0 / np.sqrt((np.cos(ANGLES) / a) ** 2 + (np.sin(ANGLES) / b) ** 2)
    return np.broadcast_to(radius, (SPOKES, HEIGHTS)).copy()


def test_an_ellipse_is_its_own_outline():
    np.testing.assert_allclose(outline(ellipses(), ALL), ellipses(), rtol=1e-9)
    # off its centre it is a conic with linear terms
    x, y = 0.13 * np.cos(ANGLES) + 0.02, 0.13 * np.sin(ANGLES) - 0.01
    away = np.hypot(x, y)
    turned = np.interp(ANGLES[:, 0], np.arctan2(y, x)[:, 0] % (2 * np.pi), away[:, 0],
                       period=2 * np.pi)  # fmt: skip
    radius = np.broadcast_to(turned[:, None], ALL.shape).copy()
    np.testing.assert_allclose(outline(radius, ALL), radius, rtol=2e-3)


def test_half_an_ellipse_is_enough():
    seen = np.broadcast_to(np.sin(ANGLES) > -0.2, ALL.shape)
    radius = np.where(seen, ellipses(), np.nan_to_num(np.nan, nan=7.0))
    found = outline(radius, seen)
    np.testing.assert_allclose(found[seen], ellipses()[seen], rtol=0.02)
    np.testing.assert_allclose(found[~seen], ellipses()[~seen], rtol=0.1)


def test_nothing_lies_beyond_the_plane_and_it_is_touched():
    """A plane 9 cm under the axis, the back unseen: the outline reaches it."""
    seen = np.broadcast_to(np.sin(ANGLES) > 0.0, ALL.shape)
    down = -np.sin(ANGLES)
    limit = np.where(down > 0.1, 0.09 / np.maximum(down, 0.1), np.inf)
    limit = np.broadcast_to(limit, ALL.shape)
    found = outline(np.where(seen, ellipses(), 1.0), seen, limit)
    assert (found <= limit).all()
    lowest = (found * down).max(axis=0)
    np.testing.assert_allclose(lowest, 0.09, rtol=0.03)


def test_it_stays_within_half_and_twice_the_median():
    seen = np.zeros_like(ALL)
    seen[:5] = True  # next to nothing was seen
    wild = np.where(seen, np.linspace(0.05, 0.4, SPOKES)[:, None], 0.0)
    median = float(np.median(wild[seen]))
    found = outline(wild, seen)
    assert (found >= 0.5 * median).all() and (found <= 2.0 * median).all()


N_THETA, N_Z, Z_STEP = 90, 24, 0.012
THETA = np.arange(N_THETA)[:, None] * (2 * np.pi / N_THETA)
HEIGHT = np.linspace(-0.5, 0.5, N_Z)[None, :]


def ellipse(a, b):
    r = 1 / np.sqrt((np.cos(THETA) / a) ** 2 + (np.sin(THETA) / b) ** 2)
    return np.broadcast_to(r, (N_THETA, N_Z)).copy()


def test_outline_is_exact_for_an_ellipse():
    truth = ellipse(0.12, 0.17)
    everything = np.ones(truth.shape, bool)
    np.testing.assert_allclose(outline(truth, everything), truth, rtol=1e-9)
    front = np.broadcast_to(np.cos(THETA) > -0.5, truth.shape)
    got = outline(np.where(front, truth, 9.9), front)
    np.testing.assert_allclose(got, truth, rtol=1e-6)


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


def test_outline_touches_the_support_and_never_passes_it():
    c = np.cos(THETA)
    with np.errstate(divide="ignore"):
        limit = np.where(c < -1e-6, -0.10 / c, np.inf)
    limit = np.broadcast_to(limit, (N_THETA, N_Z))
    front = np.broadcast_to(c > -0.2, limit.shape)
    got = outline(np.where(front, ellipse(0.12, 0.17), 0.3), front, limit)
    assert (got <= limit + 1e-12).all()
    assert got[N_THETA // 2].min() > 0.09


@pytest.mark.parametrize("degrees", [60, 90, 120])
def test_little_seen_gives_a_finite_outline(degrees):
    sector = np.broadcast_to(np.radians(degrees) > THETA, (N_THETA, N_Z))
    got = outline(np.where(sector, ellipse(0.12, 0.17), np.nan_to_num(0.0)), sector)
    assert np.isfinite(got).all()
    assert got.min() > 0.05 and got.max() < 0.35


def test_what_was_seen_stays():
    """A wavy surface with small variance is returned as it is."""
    truth = ellipse(0.12, 0.17) + 0.004 * np.sin(3 * THETA) * np.cos(4 * HEIGHT)
    seen = np.ones(truth.shape, bool)
    filled = fill_smoothly(truth, np.full(truth.shape, 1e-10), seen, z_step=Z_STEP)
    np.testing.assert_allclose(filled.radius, truth, atol=2e-6)
    np.testing.assert_allclose(filled.std, 1e-5)


def test_noise_is_smoothed():
    rng = np.random.default_rng(0)
    truth = ellipse(0.12, 0.17)
    noisy = truth + 0.001 * rng.standard_normal(truth.shape)
    seen = np.ones(truth.shape, bool)
    filled = fill_smoothly(noisy, np.full(truth.shape, 1e-6), seen, z_step=Z_STEP)
    assert np.std(filled.radius - truth) < 0.8 * np.std(noisy - truth)
    assert abs((filled.radius - truth).mean()) < 5e-5


def test_hole_is_bridged_across_the_lap():
    """A hole of 6 cm at θ = 0, where the array begins and ends."""
    truth = ellipse(0.12, 0.17) + 0.01 * HEIGHT
    arc = 0.14 * np.angle(np.exp(1j * THETA))
    seen = np.hypot(arc, (np.arange(N_Z) - 12)[None, :] * Z_STEP) > 0.03
    filled = fill_smoothly(
        np.where(seen, truth, 1.0), np.full(truth.shape, 1e-6), seen, z_step=Z_STEP
    )
    assert np.abs(filled.radius - truth).max() < 0.001
    assert filled.std[0, 12] > 3 * filled.std[30, 12]


def test_unseen_back_stops_at_the_support():
    c = np.cos(THETA)
    with np.errstate(divide="ignore"):
        limit = np.where(c < -1e-6, -0.08 / c, np.inf)
    limit = np.broadcast_to(limit, (N_THETA, N_Z))
    truth = ellipse(0.14, 0.14)
    seen = np.broadcast_to(c > -0.4, truth.shape)
    variance = np.full(truth.shape, 1e-6)
    free = fill_smoothly(truth, variance, seen, z_step=Z_STEP)
    held = fill_smoothly(truth, variance, seen, z_step=Z_STEP, limit=limit)
    assert (free.radius > limit).any()
    assert (held.radius[~seen] <= limit[~seen] + 1e-12).all()
    np.testing.assert_allclose(held.radius[seen], truth[seen], atol=0.004)


def test_deviation_grows_with_the_distance():
    truth = ellipse(0.14, 0.14)
    seen = np.broadcast_to(np.cos(THETA) > 0, truth.shape)
    quarter, half = N_THETA // 4 + 1, N_THETA // 2
    distance = 0.14 * np.pi / 2
    far = np.full(truth.shape, 9.0)
    for limit, (most, length) in ((None, (0.060, 0.130)), (far, (0.020, 0.045))):
        variance = np.full(truth.shape, 1e-6)
        std = fill_smoothly(truth, variance, seen, z_step=Z_STEP, limit=limit).std
        assert (np.diff(std[quarter:half, 5]) > 0).all()
        expected = most * (1.0 - np.exp(-distance / length))
        assert std[half, 5] == pytest.approx(expected, rel=0.05)
