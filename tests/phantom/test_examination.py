import dataclasses

import numpy as np
import pytest

from tests.kit import InputError, refuses
from ttus_opt.phantom.examination import push_handling, sweep_handling
from ttus_opt.phantom.example_data import PROBE
from ttus_opt.phantom.probe import EllipsoidProbe
from ttus_opt.phantom.torso import Torso

TORSO = Torso()


def lowest_point_depth(path, m):
    """How far the probe reaches below the skin's tangent plane, by sampling it."""
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(200_000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    return ball * PROBE.semi_axes @ path.rotation[m].T + path.position[m]


@pytest.mark.parametrize("frame", [30, 133, 280])
def test_depth_is_below_the_tangent_plane(frame):
    hand = push_handling(np.random.default_rng(4))
    path = hand.poses(TORSO, PROBE)
    front = TORSO.radius(np.array(np.pi / 2), np.array(TORSO.length / 2))
    theta, z = np.pi / 2 - hand.across[frame] / front, hand.along[frame]
    skin, normal = TORSO.skin(theta, z), TORSO.normals(theta, z)
    heights = (lowest_point_depth(path, frame) - skin) @ normal
    assert -heights.min() == pytest.approx(hand.depth[frame], abs=2e-5)


def test_level_probe_lies_across_the_body_and_looks_in():
    hand = sweep_handling(np.random.default_rng(0))
    zero = np.zeros_like(hand.time)
    flat = dataclasses.replace(hand, rock=zero, fan=zero, turn=zero, across=zero)
    path = flat.poses(Torso(swell=0.0), EllipsoidProbe((0.03, 0.0125, 0.018)))
    assert path.rotation[:, :, 2] == pytest.approx(
        np.tile([0.0, -1.0, 0.0], (len(path), 1)), abs=1e-9
    )
    assert np.abs(path.rotation[:, 0, 0]) == pytest.approx(1.0)


def test_pushes_lift_off_reach_their_depth_and_cover_the_square():
    hand = push_handling(np.random.default_rng(8), n_pushes=8, deepest=0.012)
    assert len(hand.time) == 400
    assert np.diff(hand.time) == pytest.approx(0.05)
    assert hand.depth.max() == pytest.approx(0.012, rel=0.02)
    lifted = hand.depth < 0.0
    assert (np.diff(lifted.astype(int)) == 1).sum() >= 7
    assert np.abs(hand.across).max() < 0.017
    assert np.ptp(hand.across) > 0.012
    assert np.ptp(hand.along) > 0.012


def test_sweep_goes_there_and_back_in_contact():
    hand = sweep_handling(np.random.default_rng(3))
    assert hand.along.max() == pytest.approx(0.205, abs=1e-3)
    assert hand.along[[0, -1]] == pytest.approx(0.095, abs=1e-3)
    assert hand.depth.min() >= 0.004 - 1e-12
    assert hand.depth.max() <= 0.010 + 1e-12
    assert np.ptp(hand.fan) > 0.3


def test_paths_follow_their_seed():
    one, same, other = (push_handling(np.random.default_rng(s)) for s in (1, 1, 2))
    assert np.array_equal(one.depth, same.depth)
    assert not np.array_equal(one.depth, other.depth)


def test_refuses_a_single_push():
    refuses(InputError, "n_pushes", push_handling, np.random.default_rng(0), n_pushes=1)
