"""Errors of poses: drawn ones have the stated size and correlation, and come off."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.kit import InputError, presses, refuses, torso
from ttus_opt.phantom import recording


def two_recordings():
    each = presses(torso(), 7, np.random.default_rng(0))
    return tt.Trajectory.concatenate([each, each])


def test_the_phantoms_errors_have_the_default_noise():
    """The simulation has an autoregression of its own."""
    noise = tt.TrackerNoise()
    still = presses(torso(), 3, np.random.default_rng(1))
    rng = np.random.default_rng(2)
    drawn = np.stack(
        [recording.add_pose_noise(still, rng).position for _ in range(2000)]
    )
    errors = (drawn - still.position) / noise.position  # (draws, T, 3)
    seen = np.einsum("nti,nui->tu", errors, errors) / (3 * len(errors))
    expected = noise.correlations(still, np.arange(3))
    np.testing.assert_allclose(seen, expected, atol=0.055)


def test_errors_of_two_recordings_have_nothing_to_do_with_each_other():
    both = two_recordings()
    frames = np.array([1, 9])
    alike = tt.TrackerNoise(correlation=0.3).correlations(both, frames)
    for t in range(len(both)):
        for j, frame in enumerate(frames):
            same = both.segment[t] == both.segment[frame]
            apart = abs(both.time[t] - both.time[frame])
            assert alike[t, j] == pytest.approx(np.exp(-apart / 0.3) if same else 0.0)


def test_errors_that_are_new_in_every_frame():
    both = two_recordings()
    alike = tt.TrackerNoise(correlation=0.0).correlations(both, np.arange(14))
    np.testing.assert_array_equal(alike, np.eye(14))


def test_errors_come_off():
    noise = tt.TrackerNoise(1e-3, 0.02)
    true = presses(torso(), 5, np.random.default_rng(3))
    xi = np.random.default_rng(4).standard_normal((5, 6))
    turn = Rotation.from_rotvec(0.02 * xi[:, 3:]).as_matrix()  # about patient axes
    rotation, position = noise.moved(true.rotation, true.position, xi)
    np.testing.assert_allclose(position, true.position + 1e-3 * xi[:, :3])
    np.testing.assert_allclose(rotation, turn @ true.rotation)
    reported = tt.Trajectory(true.time, position, rotation)
    found = noise.without(reported, xi)
    np.testing.assert_allclose(found.position, true.position, atol=1e-15)
    np.testing.assert_allclose(found.rotation, true.rotation, atol=1e-14)
    np.testing.assert_allclose(noise.sizes, [1e-3] * 3 + [0.02] * 3)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"position": 0.5}, "at most 10 mm, got 500 mm: it is given in metres"),
        ({"position": 0.0}, "above 0"),
        ({"position": np.nan}, "above 0"),
        ({"rotation": 0.5}, "at most 10°, got 28.6479°: it is given in radians"),
        ({"rotation": -0.01}, "above 0"),
        ({"correlation": -1.0}, "correlation time must be finite"),
        ({"correlation": np.inf}, "correlation time must be finite"),
        ({"correlation": np.nan}, "correlation time must be finite"),
    ],
)
def test_noise_that_is_none(given, said):
    refuses(InputError, said, tt.TrackerNoise, **given)
