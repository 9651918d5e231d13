"""Velocities of noisy paths: against dense regression and what was simulated."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ttus_opt.probe.smooth_motion import LEAST_FRAMES, smooth_motion
from ttus_opt.probe.trajectory import Trajectory

STEP = 0.05


def hand(time):
    """Path [m] and velocity of presses of 12 mm that slide by 4 mm, shape (T, 3)."""
    deep, slow = 2.0 * np.pi * 0.4, 2.0 * np.pi * 0.15
    path = np.stack(
        [0.006 * np.cos(deep * time), 0.002 * np.sin(slow * time), 0.0 * time], axis=1
    )
    velocity = np.stack(
        [
            -0.006 * deep * np.sin(deep * time),
            0.002 * slow * np.cos(slow * time),
            0.0 * time,
        ],
        axis=1,
    )
    return path, velocity


def noise(n, drift, jitter, seed=1):
    """Brownian drift [m/√s] and jitter [m] at `STEP`, shape (n, 3)."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(0.0, drift * np.sqrt(STEP), (n, 3)), axis=0)
    return np.asarray(walk + rng.normal(0.0, jitter, (n, 3)))


def dense(path, time, jerk, drift, jitter):
    """The same regression by dense algebra: ∫ (s−u)²₊/2 (t−u)²₊/2 du and parabolas."""
    t = time - time[0]
    s, u = np.meshgrid(t, t, indexing="ij")
    m, d = np.minimum(s, u), np.abs(s - u)
    motion = m**5 / 20.0 + d * m**4 / 8.0 + d**2 * m**3 / 12.0
    slope = 0.5 * (
        s * u * u * m - (u * u + 2 * s * u) * m**2 / 2 + (s + 2 * u) * m**3 / 3
        - m**4 / 4
    )  # fmt: skip
    covariance = jerk**2 * motion + drift**2 * m + jitter**2 * np.eye(len(t))
    known = np.stack([np.ones_like(t), t, t**2 / 2], axis=1)
    slopes = np.stack([0 * t, np.ones_like(t), t], axis=1)
    weighted = np.linalg.solve(covariance, known)
    start = np.linalg.solve(weighted.T @ known, weighted.T @ path)
    rest = np.linalg.solve(covariance, path - known @ start)
    return np.asarray(slopes @ start + jerk**2 * slope @ rest)


@pytest.mark.parametrize("uneven", [False, True])
def test_it_is_the_regression_of_the_model(uneven):
    n = 90
    time = 3.0 + STEP * np.arange(n)
    if uneven:
        time[1:-1] += np.random.default_rng(2).uniform(-0.02, 0.02, n - 2)
    path = hand(time)[0] + noise(n, 0.7e-3, 0.1e-3)
    found = smooth_motion(path, time)
    expected = dense(path, time, found.jerk, found.drift, found.jitter)
    np.testing.assert_allclose(found.velocity, expected, atol=1e-7)


def test_the_noise_is_found_and_its_deviation_is_told():
    n = 1200
    time = STEP * np.arange(n)
    path, velocity = hand(time)
    for drift, jitter in ((0.7e-3, 0.0), (0.0, 0.5e-3), (0.7e-3, 0.1e-3)):
        noisy = path + noise(n, drift, jitter)
        found = smooth_motion(noisy, time)
        assert found.drift == pytest.approx(drift, rel=0.2, abs=2e-4)
        assert found.jitter == pytest.approx(jitter, rel=0.2, abs=1e-4)
        off = np.sqrt(((found.velocity - velocity) ** 2).mean())
        raw = np.gradient(noisy, STEP, axis=0)[1:-1] - velocity[1:-1]
        told = np.sqrt((found.std**2).mean())
        assert 0.6 * told < off < 1.4 * told
        assert off < 0.7 * np.sqrt((raw**2).mean())
        expected = np.sqrt((raw**2).mean())
        assert found.difference_std == pytest.approx(expected, rel=0.15)


def trajectory(path, turns):
    """Poses at `STEP` from positions and rotation vectors."""
    rotation = Rotation.from_rotvec(turns).as_matrix()
    return Trajectory(STEP * np.arange(len(path)), path, rotation)


def differences(recording):
    return np.hstack([recording.velocity(), recording.angular_velocity()])


def test_a_hand_at_rest_under_a_tracker_hardly_moves():
    """Differences say 4 mm/s and 4 °/s, twice the deadband."""
    turns = np.radians(noise(300, 0.0, 0.5, 3) / np.sqrt(3.0))
    recording = trajectory(noise(300, 0.2e-3, 0.3e-3), turns)
    assert np.sqrt((differences(recording) ** 2).mean(axis=0)).min() > 3e-3
    twist = recording.twist()
    assert np.sqrt((twist[:, :3] ** 2).mean()) < 0.5e-3
    assert np.degrees(np.sqrt((twist[:, 3:] ** 2).mean())) < 0.5


def test_a_noisy_turn_is_found():
    n = 600
    spin, start = np.array([0.3, -0.2, 0.1]), Rotation.from_rotvec([0.4, 1.0, -0.3])
    true = Rotation.from_rotvec(STEP * np.arange(n)[:, None] * spin) * start
    errors = Rotation.from_rotvec(np.radians(noise(n, 0.0, 0.3)))
    moving = trajectory(hand(STEP * np.arange(n))[0], (errors * true).as_rotvec())
    off = moving.twist()[:, 3:] - spin
    raw = moving.angular_velocity() - spin
    assert np.sqrt((off**2).mean()) < 0.1 * np.sqrt((raw**2).mean())
    # positions are exact: their differences are kept
    np.testing.assert_array_equal(moving.twist()[:, :3], moving.velocity())


def test_differences_of_exact_poses_are_kept():
    """Also of a robot that starts and stops at once, and of few frames."""
    path, _ = hand(STEP * np.arange(120))
    path[40:60], path[60:] = path[40], path[60:] - path[60] + path[40]
    exact = trajectory(path, 10.0 * path)
    np.testing.assert_array_equal(exact.twist(), differences(exact))
    assert not exact.twist()[41:60].any()
    still = trajectory(np.ones((50, 3)), np.zeros((50, 3)))
    assert np.abs(still.twist()).max() < 1e-12
    few = LEAST_FRAMES - 1
    noisy = trajectory(path[:few] + noise(few, 0.0, 1e-3), 10.0 * path[:few])
    np.testing.assert_array_equal(noisy.twist(), differences(noisy))
    for n in (1, 2, 3):
        short = noisy.select(slice(0, n))
        np.testing.assert_array_equal(short.twist(), differences(short))


def test_places_all_over_the_body_are_no_path():
    rng = np.random.default_rng(6)
    places = trajectory(rng.normal(0.0, 0.05, (80, 3)), rng.normal(0.0, 0.5, (80, 3)))
    np.testing.assert_array_equal(places.twist(), differences(places))


def test_nothing_is_smoothed_across_recordings_and_jumps():
    path = hand(STEP * np.arange(200))[0] + noise(200, 0.5e-3, 0.2e-3)
    here = trajectory(path, 10.0 * path)
    there = Trajectory(here.time, 0.5 + path[::-1], here.rotation)
    both = Trajectory.concatenate([here, there])
    np.testing.assert_array_equal(both.twist()[:200], here.twist())
    np.testing.assert_array_equal(both.twist()[200:], there.twist())
    cut = path.copy()
    cut[100:] += [0.03, 0.0, -0.02]
    jumped = trajectory(cut, np.zeros_like(cut)).twist()[:, :3]
    smooth = trajectory(path, np.zeros_like(cut)).twist()[:, :3]
    raw = np.abs(trajectory(cut, np.zeros_like(cut)).velocity() - smooth).max(axis=1)
    assert raw[99:101].min() > 0.25
    assert np.abs(jumped - smooth).max() < 5e-3  # one-sided beside the jump
    assert np.abs(jumped - smooth)[np.r_[:85, 115:200]].max() < 3e-4


def test_one_frame_that_is_off_does_not_spread():
    path = hand(STEP * np.arange(200))[0] + noise(200, 0.3e-3, 0.1e-3)
    off = path.copy()
    off[70] += 0.05
    turns = np.zeros_like(path)
    found, expected = (trajectory(p, turns).twist()[:, :3] for p in (off, path))
    apart = np.abs(found - expected).max(axis=1)
    assert apart[np.r_[:55, 85:200]].max() < 3e-4
    assert np.delete(apart, [70]).max() < 5e-3
    # of a piece of one frame differences are kept
    np.testing.assert_array_equal(found[70], trajectory(off, turns).velocity()[70])
