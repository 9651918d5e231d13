"""The twist from poses and times: exact when steady, still at rest, late as stated."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ttus_opt.contact.friction import DEADBAND
from ttus_opt.errors import InputError
from ttus_opt.haptic.motion import MOTION, MotionFilter, estimate_twist

REFERENCE = np.array([0.01, -0.02, 0.03])
LENGTH = 0.017
LAW = MotionFilter()
STEP = 1e-3


def follow(
    rotation: np.ndarray,
    position: np.ndarray,
    step: float = STEP,
    law: MotionFilter = LAW,
) -> np.ndarray:
    """Twists of all frames, shape (T, 6)."""
    motion, twist, found = np.zeros(MOTION), np.zeros(6), []
    numbers = law.kernel_numbers(LENGTH)
    for k, (R, at) in enumerate(zip(rotation, position, strict=True)):
        assert estimate_twist(motion, R, at, 7.0 + k * step, REFERENCE, numbers, twist)
        found.append(twist.copy())
    return np.array(found)


def screw(n: int, velocity: np.ndarray, spin: np.ndarray) -> tuple[np.ndarray, ...]:
    """The reference moves evenly while the probe spins evenly."""
    t = STEP * np.arange(n)[:, None]
    start = Rotation.from_rotvec([0.3, -0.8, 0.5])
    rotation = (Rotation.from_rotvec(t * spin) * start).as_matrix()
    return rotation, t * velocity - rotation @ REFERENCE


def test_a_steady_motion_is_found_exactly() -> None:
    velocity, spin = np.array([0.02, 0.05, -0.01]), np.array([0.5, -1.0, 2.0])
    rotation, position = screw(600, velocity, spin)
    found = follow(rotation, position)
    assert not found[0].any()
    origin = velocity - np.cross(spin, rotation[-1] @ REFERENCE)
    np.testing.assert_allclose(found[-1], [*origin, *spin], rtol=1e-6, atol=1e-9)


def test_it_lags_by_the_play_and_the_time_constant() -> None:
    """(1 − e^(−t/T)) of the speed after the play has been taken up."""
    speed = 0.02
    rotation, position = screw(200, np.array([0.0, 0.0, speed]), np.zeros(3))
    found = follow(rotation, position)[:, 2]
    begins = LAW.play / (speed * STEP)  # frames
    assert not found[: int(begins)].any()
    since = STEP * (np.arange(200) - begins)
    expected = speed * (1.0 - np.exp(-np.maximum(since, 0.0) / LAW.seconds))
    np.testing.assert_allclose(found, expected, atol=0.05 * speed)


def test_a_jitter_is_rest() -> None:
    """±0.05 mm and ±0.1° at 1 kHz: differences say 50 mm/s, the follower nothing."""
    rng = np.random.default_rng(3)
    n = 4000
    position = np.array([0.1, 0.2, 0.3]) + rng.uniform(-5e-5, 5e-5, (n, 3))
    turns = np.deg2rad(rng.uniform(-0.1, 0.1, (n, 3)))
    rotation = Rotation.from_rotvec(turns).as_matrix()
    centre = position + rotation @ REFERENCE - REFERENCE
    raw = np.linalg.norm(np.diff(centre, axis=0), axis=1) / STEP
    assert np.median(raw) > 0.03
    found = follow(rotation, position - rotation @ REFERENCE + REFERENCE)
    assert np.abs(found[:, :3]).max() < 0.25 * DEADBAND  # while it finds the middle
    assert np.abs(found[3000:]).max() < 1e-15
    assert not found[:, 3:].any()


def test_a_slow_slide_keeps_its_direction_under_jitter() -> None:
    rng = np.random.default_rng(5)
    rotation, position = screw(3000, np.array([0.01, 0.0, 0.0]), np.zeros(3))
    found = follow(rotation, position + rng.uniform(-5e-5, 5e-5, position.shape))[500:]
    angle = np.degrees(np.arctan2(np.linalg.norm(found[:, 1:3], axis=1), found[:, 0]))
    assert np.percentile(angle, 95) < 25.0
    assert found[:, 0].mean() == pytest.approx(0.01, rel=0.02)
    assert found[:, 0].min() > 2e-3


def test_the_same_time_again_changes_nothing_and_a_pause_starts_anew() -> None:
    motion, twist, numbers = np.zeros(MOTION), np.zeros(6), LAW.kernel_numbers(LENGTH)
    for k in range(100):
        at = np.array([0.0, 0.05 * STEP * k, 0.0])
        assert estimate_twist(
            motion, np.eye(3), at, STEP * k, REFERENCE, numbers, twist
        )
    before, state = twist.copy(), motion.copy()
    assert estimate_twist(
        motion, np.eye(3), at + 1.0, STEP * 99, REFERENCE, numbers, twist
    )
    np.testing.assert_array_equal(twist, before)
    for late in (STEP * 98, float("nan"), float("inf")):
        assert not estimate_twist(
            motion, np.eye(3), at, late, REFERENCE, numbers, twist
        )
    np.testing.assert_array_equal(motion, state)
    assert estimate_twist(motion, np.eye(3), at + 1.0, 1.0, REFERENCE, numbers, twist)
    assert not twist.any()


@pytest.mark.parametrize("name", ["play", "seconds", "gap"])
def test_unusable_filters(name: str) -> None:
    for value in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match=f"{name} must be positive"):
            MotionFilter(**{name: value})
