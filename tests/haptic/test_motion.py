"""The twist from poses and times: exact when steady, still at rest, late as stated."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from tests.kit import InputError, refuses
from ttus_opt.contact.friction import DEADBAND
from ttus_opt.haptic.motion import (
    DEVIATIONS,
    FOLLOWER,
    JITTER,
    MEMORY,
    MOTION,
    TWICE,
    MotionFilter,
    estimate_twist,
)

REFERENCE = np.array([0.01, -0.02, 0.03])
LENGTH = 0.017
LAW = MotionFilter()
STEP = 1e-3


def follow(rotation, position, step=STEP, law=LAW):
    """Twists of all frames, shape (T, 6)."""
    motion, twist, found = np.zeros(MOTION), np.zeros(6), []
    numbers = law.kernel_numbers(LENGTH)
    for k, (R, at) in enumerate(zip(rotation, position, strict=True)):
        assert estimate_twist(motion, R, at, 7.0 + k * step, REFERENCE, numbers, twist)
        found.append(twist.copy())
    return np.array(found)


def screw(n, velocity, spin):
    """The reference moves evenly while the probe spins evenly."""
    t = STEP * np.arange(n)[:, None]
    start = Rotation.from_rotvec([0.3, -0.8, 0.5])
    rotation = (Rotation.from_rotvec(t * spin) * start).as_matrix()
    return rotation, t * velocity - rotation @ REFERENCE


def test_a_steady_motion_is_found_exactly():
    velocity, spin = np.array([0.02, 0.05, -0.01]), np.array([0.5, -1.0, 2.0])
    rotation, position = screw(600, velocity, spin)
    found = follow(rotation, position)
    assert not found[0].any()
    origin = velocity - np.cross(spin, rotation[-1] @ REFERENCE)
    np.testing.assert_allclose(found[-1], [*origin, *spin], rtol=1e-6, atol=1e-9)


def test_it_lags_by_three_low_passes_and_the_play():
    """Against scipy's filters, and the follower of a ramp step by step."""
    speed, kept = 0.02, np.exp(-STEP / LAW.seconds)
    rotation, position = screw(300, np.array([0.0, 0.0, speed]), np.zeros(3))
    found = follow(rotation, position)[:, 2]
    low = [1.0 - kept], [1.0, -kept]
    smooth = lfilter(*low, lfilter(*low, speed * STEP * np.arange(300)))
    drawn, follower = np.zeros(300), 0.0
    for k, x in enumerate(smooth):
        if x - follower > LAW.play:
            drawn[k] = x - LAW.play - follower
            follower = x - LAW.play
        else:
            follower += (1.0 - np.exp(-STEP / MEMORY)) * (x - follower)
    expected = lfilter(*low, drawn / STEP)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    late = STEP * np.arange(300) - 2.0 * LAW.seconds - LAW.play / speed
    assert not found[late < -2.0 * LAW.seconds].any()
    assert found[np.searchsorted(late, 5.0 * LAW.seconds)] > 0.95 * speed


@pytest.mark.parametrize("jitter", [5e-5, 5e-4])
@pytest.mark.parametrize("rate", [1000.0, 500.0, 60.0])
def test_a_jitter_is_rest(jitter, rate):
    """Normal errors of 0.05 and 0.5 mm and degrees: the play follows what it sees."""
    rng, n = np.random.default_rng(3), int(8 * rate)
    position = np.array([0.1, 0.2, 0.3]) + rng.normal(0.0, jitter, (n, 3))
    turns = np.deg2rad(rng.normal(0.0, 1e3 * jitter, (n, 3)))
    rotation = Rotation.from_rotvec(turns).as_matrix()
    raw = np.linalg.norm(np.diff(position, axis=0), axis=1) * rate
    assert np.median(raw) > (0.05 if rate > 100 else 0.005)
    placed = position - rotation @ REFERENCE + REFERENCE
    found = follow(rotation, placed, 1.0 / rate)[int(2 * rate) :]
    assert np.abs(found).max() < 1e-6 * DEADBAND


def test_the_play_is_no_wider_than_the_jitter_asks_for():
    """Exact poses, however they are turned, keep the play that is stated."""
    velocity, spin = np.array([0.02, 0.05, -0.01]), np.array([0.5, -1.0, 2.0])
    rotation, position = screw(600, velocity, spin)
    motion, twist = np.zeros(MOTION), np.zeros(6)
    numbers = LAW.kernel_numbers(LENGTH)
    for k, (R, at) in enumerate(zip(rotation, position, strict=True)):
        estimate_twist(motion, R, at, STEP * k, REFERENCE, numbers, twist)
    assert np.sqrt(motion[JITTER : JITTER + 2]).max() < 1e-8
    rng = np.random.default_rng(5)
    motion[:] = 0.0
    for k in range(4000):
        noisy = position[k % 600] * 0.0 + rng.normal(0.0, 2e-4, 3)
        turn = Rotation.from_rotvec(rng.normal(0.0, 3e-3, 3)).as_matrix()
        at = noisy - turn @ REFERENCE
        estimate_twist(motion, turn, at, STEP * k, REFERENCE, numbers, twist)
    found = np.sqrt(motion[JITTER : JITTER + 2])
    np.testing.assert_allclose(found, [2e-4, 3e-3], rtol=0.15)


@pytest.mark.parametrize("sigma", [0.0, 2e-4])
def test_uneven_steps_are_no_jitter(sigma):
    """A steady motion seen after 1 and 3 ms in turn, and errors of its poses."""
    rng = np.random.default_rng(6)
    motion, twist, numbers = np.zeros(MOTION), np.zeros(6), LAW.kernel_numbers(LENGTH)
    time = np.cumsum(np.tile([1e-3, 3e-3], 1000))
    found = []
    for t in time:
        at = np.array([0.05 * t, 0.02, 0.03]) + rng.normal(0.0, sigma, 3)
        turn = Rotation.from_rotvec([0.0, 0.0, 0.5 * t]).as_matrix()
        at -= turn @ REFERENCE
        assert estimate_twist(motion, turn, at, t, REFERENCE, numbers, twist)
        found.append(motion[JITTER])
    assert np.sqrt(np.mean(found[500:])) == pytest.approx(sigma, rel=0.05, abs=1e-9)


def test_the_play_is_five_deviations_of_the_smoothed_jitter():
    """A follower that is drawn along lies that far behind; smoothed by scipy."""
    rng, sigma, n = np.random.default_rng(7), 1e-3, 3000
    kept = np.exp(-STEP / LAW.seconds)
    low = [1.0 - kept], [1.0, -kept]
    smoothed = lfilter(*low, lfilter(*low, rng.normal(0.0, sigma, 200_000)))
    motion, twist, numbers = np.zeros(MOTION), np.zeros(6), LAW.kernel_numbers(LENGTH)
    behind = []
    for k in range(n):
        at = np.array([0.1 * STEP * k, 0.0, 0.0]) + rng.normal(0.0, sigma, 3)
        estimate_twist(motion, np.eye(3), at, STEP * k, REFERENCE, numbers, twist)
        apart = motion[TWICE : TWICE + 3] - motion[FOLLOWER : FOLLOWER + 3]
        behind.append(np.linalg.norm(apart))
    expected = DEVIATIONS * smoothed[1000:].std()
    assert expected > 5.0 * LAW.play
    assert np.mean(behind[1000:]) == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("speed", [3e-3, 1e-2])
def test_a_slow_slide_keeps_its_direction_under_jitter(speed):
    rng = np.random.default_rng(5)
    rotation, position = screw(3000, np.array([speed, 0.0, 0.0]), np.zeros(3))
    noisy = position + rng.normal(0.0, 5e-5, position.shape)
    found = follow(rotation, noisy)[500:]
    angle = np.degrees(np.arctan2(np.linalg.norm(found[:, 1:3], axis=1), found[:, 0]))
    assert np.percentile(angle, 95) < 15.0
    assert found[:, 0].mean() == pytest.approx(speed, rel=0.03)
    assert found[:, 0].min() > 0.3 * speed
    # from frame to frame it hardly changes
    change = np.linalg.norm(np.diff(found[:, :3], axis=0), axis=1)
    assert np.percentile(change, 99) < 0.1 * DEADBAND


def test_at_a_trackers_rate_it_smooths_over_frames():
    """10 ms are less than a frame at 60 Hz: the time constant is two frames."""
    rng, n = np.random.default_rng(5), 1200
    position = np.outer(np.arange(n) / 60.0, [0.01, 0.0, 0.0])
    noisy = position + rng.normal(0.0, 5e-5, (n, 3))
    found = follow(np.tile(np.eye(3), (n, 1, 1)), noisy, 1.0 / 60.0)[100:, :3]
    assert found[:, 0].mean() == pytest.approx(0.01, rel=0.02)
    assert found[:, 0].std() < 0.8e-3


def test_the_same_time_again_changes_nothing_and_a_pause_starts_anew():
    motion, twist, numbers = np.zeros(MOTION), np.zeros(6), LAW.kernel_numbers(LENGTH)

    def estimate(at, time):
        return estimate_twist(motion, np.eye(3), at, time, REFERENCE, numbers, twist)

    for k in range(100):
        at = np.array([0.0, 0.05 * STEP * k, 0.0])
        assert estimate(at, STEP * k)
    before, state = twist.copy(), motion.copy()
    assert estimate(at + 1.0, STEP * 99)
    np.testing.assert_array_equal(twist, before)
    for late in (STEP * 98, float("nan"), float("inf")):
        assert not estimate(at, late)
    np.testing.assert_array_equal(motion, state)
    assert estimate(at + 1.0, 1.0)
    assert not twist.any()


@pytest.mark.parametrize("name", ["play", "seconds", "gap"])
def test_unusable_filters(name):
    for value in (0.0, -1.0, float("nan"), float("inf")):
        refuses(InputError, f"{name} must be positive", MotionFilter, **{name: value})
