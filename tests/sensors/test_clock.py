"""Offsets of two clocks: known ones are found, unclear ones refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.kit import InputError, refuses
from ttus_opt.sensors import clock
from ttus_opt.sensors.clock import (
    ROUNDED,
    Signal,
    clock_offset,
    contact_of_force,
    contact_of_poses,
    gravity_of_poses,
    gravity_of_readings,
)


def wander(time):
    """An irregular motion, the same whenever it is asked."""
    return sum(
        np.sin(2 * np.pi * f * time + p)
        for f, p in ((0.31, 0.2), (0.73, 1.1), (1.27, 2.5), (0.113, 4.0))
    )


@pytest.mark.parametrize("offset", [-1.2345, 0.0, 0.00731, 2.1])
@pytest.mark.parametrize("rates", [(100.0, 40.0), (30.0, 150.0)])
def test_a_known_offset_is_found(offset, rates):
    rng = np.random.default_rng(0)
    first = np.arange(3.0, 23.0, 1 / rates[0])
    second = np.arange(2.0, 21.0, 1 / rates[1])
    found = clock_offset(
        Signal(first, wander(first) + rng.normal(0, 0.05, len(first))),
        Signal(second, 3 * wander(second + offset) + 7),
        largest=3.0,
    )
    assert found.seconds == pytest.approx(offset, abs=0.1 / min(rates))
    assert found.correlation > 0.95
    assert found.rival < 0.9


def test_clocks_that_count_from_elsewhere():
    time = np.arange(0, 20, 0.02)
    first = Signal(time, wander(time))
    second = Signal(time + 1.7e9, wander(time + 0.5))
    refuses(InputError, r"begin 1\.7e", clock_offset, first, second)
    found = clock_offset(first, second, around=-1.7e9)
    assert found.seconds == pytest.approx(0.5 - 1.7e9, abs=1e-2)


def test_contact_of_presses(shared):
    """Forces of the finite-element phantom, moved on their clock."""
    surface = tt.Surface.load(shared / "phantom" / "surface.nc")
    press = tt.read_trajectory(shared / "phantom" / "press_fit.csv")
    second = contact_of_force(press.time - 0.37, press.force)
    first = contact_of_poses(press, surface, float(second.values.mean()))
    # the presses come every five seconds: an offset of a press is as good
    refuses(InputError, "repeats itself", clock_offset, first, second)
    found = clock_offset(first, second, largest=0.8)
    assert found.seconds == pytest.approx(0.37, abs=0.05)  # a frame


@pytest.mark.parametrize(
    ("second", "words"),
    [
        (lambda t: np.random.default_rng(0).normal(size=t.shape), "correlate by 0"),
        (lambda t: np.full(t.shape, 2.0), "constant"),
        (lambda t: np.full(t.shape, np.nan), "NaN"),
        (lambda t: wander(t + 5.0), "or beyond|correlate by"),
    ],
)
def test_signals_that_tell_nothing(second, words):
    time = np.arange(0, 20, 0.02)
    with pytest.raises(InputError, match=words):
        clock_offset(
            Signal(time, wander(time)), Signal(time, second(time)), largest=2.0
        )


def test_what_repeats_itself_is_refused():
    time = np.arange(0, 60, 0.02)
    wave = Signal(time, np.sin(2 * np.pi * time))
    refuses(InputError, "repeats itself", clock_offset, wave, wave, largest=3.0)
    assert clock_offset(wave, wave, largest=0.4).seconds == pytest.approx(0, abs=1e-6)


def test_what_is_refused():
    time = np.arange(0, 20, 0.02)
    sound = Signal(time, wander(time))
    refuses(InputError, "at least 10", clock_offset, sound, Signal(time[:9], time[:9]))
    refuses(InputError, "finite", clock_offset, sound, sound, largest=0.0)
    refuses(InputError, "too many offsets", clock_offset, sound, sound, largest=1e5)
    with pytest.raises(InputError, match="too many"):
        clock_offset(sound, Signal(np.r_[time, 1e9], np.r_[time, 1.0]))
    with pytest.raises(InputError, match="must increase"):
        clock_offset(sound, Signal(np.zeros(20), np.arange(20.0)))
    poses = tt.Trajectory(time, np.ones((1000, 3)), np.tile(np.eye(3), (1000, 1, 1)))
    refuses(InputError, "makes and breaks contact", contact_of_poses, poses, None, 1.0)
    one = poses.select([0])  # no share of it is deepest
    refuses(InputError, "at least 10 frames, got 1", contact_of_poses, one, None, 0.5)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_gravity_needs_no_calibration(sign):
    """Bias, weight, axes and sign are unknown, noise and rate are the sensor's own."""
    rng = np.random.default_rng(3)
    time, own = np.arange(0.0, 15.0, 0.03), np.arange(-1.0, 17.0, 0.009)

    def turned(t):
        angle = np.stack([wander(t), wander(t + 40.0), wander(t + 80.0)], axis=1)
        return Rotation.from_rotvec(0.25 * angle).as_matrix()

    down = np.array([0.0, -1.0, 0.0])
    poses = tt.Trajectory(time, np.zeros((len(time), 3)), turned(time))
    axes = Rotation.from_rotvec([0.4, 2.0, -0.3]).as_matrix()
    gravity = np.einsum("tji,j->ti", turned(own + 1.37) @ axes, down)
    force = sign * (3.7 * gravity + [4.0, -2.0, 7.0])
    force += rng.normal(0.0, 0.05, force.shape)
    found = clock_offset(gravity_of_poses(poses, down), gravity_of_readings(own, force))
    assert found.seconds == pytest.approx(1.37, abs=0.004)
    assert found.correlation > 0.98


def test_slopes_of_straight_lines_are_exact():
    """For uneven steps too; a recording that is too short is refused."""
    time = np.cumsum(np.random.default_rng(1).uniform(0.005, 0.03, 200))
    found = gravity_of_readings(time, np.outer(time, [1.0, -2.0, 2.0]))
    np.testing.assert_allclose(found.values, 3.0)
    assert found.time[0] >= time[0] + 0.15
    with pytest.raises(InputError, match="too short for slopes"):
        gravity_of_readings(time[:5], np.zeros((5, 3)))


def test_an_error_is_never_below_that_of_the_parabola():
    """Without noise all parts agree; the offset still lies between samples."""
    time = np.arange(0.0, 60.0, 0.01)
    first = Signal(time, wander(time))
    assert clock_offset(first, first).std >= 0.99 * ROUNDED * 0.01


@pytest.mark.parametrize("seed", range(4))
def test_correlations_are_those_of_the_overlap_lag_by_lag(seed):
    """Gaps, signals of other lengths, lags beyond both, and a stretch at rest."""
    rng = np.random.default_rng(seed)
    a, b = rng.normal(3.0, 1.0, 90).cumsum(), rng.normal(0.0, 1.0, 70).cumsum()
    a[20:25] = b[rng.random(70) < 0.1] = np.nan
    if seed == 3:
        b[:60] = 5.0
    lags = np.arange(-100, 101)
    found = clock._correlations(a, b, lags)
    for lag, one in zip(lags, found, strict=True):
        pairs = [(a[lag + k], b[k]) for k in range(len(b)) if 0 <= lag + k < len(a)]
        x, y = np.array([p for p in pairs if np.isfinite(p).all()]).reshape(-1, 2).T
        least = 0.5 * min(np.isfinite(a).sum(), np.isfinite(b).sum())
        if len(x) < max(least, 8) or np.ptp(y) == 0.0:
            assert one == -1.0
        else:
            assert one == pytest.approx(np.corrcoef(x, y)[0, 1], abs=1e-9)
    assert (found > -1.0).sum() > 20
