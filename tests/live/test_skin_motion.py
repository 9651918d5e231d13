"""The skin's motion, continued."""

import numpy as np
import pytest

from tests.kit import InputError, refuses
from ttus_opt.live.skin_motion import AHEAD, SkinMotion


def breath(time):
    return 0.005 * np.sin(2.0 * np.pi * 0.25 * time) * np.array([0.0, 1.0, 0.0])


def test_a_line_is_continued_exactly_and_not_for_ever():
    motion, velocity = SkinMotion(), np.array([0.001, -0.002, 0.003])
    for time in (0.0, 0.03, 0.07):
        motion.see(time, time * velocity)
    np.testing.assert_allclose(motion.at(0.12), 0.12 * velocity, atol=1e-15)
    np.testing.assert_allclose(motion.at(9.0), (0.07 + AHEAD) * velocity, atol=1e-15)
    motion.see(0.05, np.ones(3))  # came too late
    np.testing.assert_allclose(motion.at(0.12), 0.12 * velocity, atol=1e-15)


@pytest.mark.parametrize(("rate", "most"), [(30.0, 1.5e-4), (60.0, 1.1e-4)])
def test_a_breath_is_followed_closer_than_it_is_seen(rate, most):
    """½ a ((age + span / 2)² - span² / 12) is what a line leaves of a breath."""
    motion, errors, late = SkinMotion(), [], []
    for now in np.arange(0.2, 8.0, 0.004):
        image = np.floor((now - 0.05) * rate) / rate
        motion.see(image, breath(image))
        errors.append(np.linalg.norm(motion.at(now) - breath(now)))
        late.append(np.linalg.norm(breath(image) - breath(now)))
    assert max(errors[50:]) < most < 0.4 * max(late)


def test_nothing_seen_is_at_rest_and_one_image_stays():
    motion = SkinMotion()
    assert not motion.at(1.0).any()
    motion.see(1.0, [0.0, 0.004, 0.0])
    np.testing.assert_array_equal(motion.at(1.1), [0.0, 0.004, 0.0])


@pytest.mark.parametrize("bad", [[0.0, np.nan, 0.0], [0.0, 0.0]])
def test_unusable_images(bad):
    refuses(InputError, "three finite numbers", SkinMotion().see, 0.0, bad)
