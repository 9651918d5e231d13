"""Agreement with the geometry against SciPy; torques about an exactly known point."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from scipy.spatial.transform import Rotation

from tests.conftest import small_scene
from ttus_opt.fitting.checks.agreement import agreement, torque_offset

SCENE = small_scene("trilinear")
PRIOR = SCENE.laplace.solve(SCENE.b)
RNG = np.random.default_rng(0)
N = 30
TURN = Rotation.random(N, rng=1).as_matrix()
FORCE = RNG.normal(0.0, 3.0, (N, 3))
EXPECTED = RNG.normal(0.0, 0.1, (N, 3))


def left(expected, measured):
    """The best scale that is not negative, and ‖rest‖²/‖measured‖²."""
    (scale,), rest = scipy.optimize.nnls(expected[:, None], measured)
    return float(scale), float(rest**2 / (measured @ measured))


def test_it_is_the_root_of_what_both_leave():
    frames = SCENE.trajectory
    found = agreement(SCENE, PRIOR, frames)
    s, of_forces = left(SCENE.N @ PRIOR, frames.force.ravel())
    k, of_torques = left(SCENE.W @ PRIOR, frames.torque.ravel())
    assert 0.0 < of_forces < of_torques
    assert found.disagreement == pytest.approx(np.sqrt(of_forces * of_torques))
    assert found.torque_ratio == pytest.approx(k / s)
    alone = agreement(SCENE, PRIOR, replace(frames, torque=None))
    assert (alone.disagreement, alone.torque_ratio) == pytest.approx((of_forces, 0.0))


def test_wrenches_of_the_field_agree_and_their_opposites_not_at_all():
    force, torque = ((M @ PRIOR).reshape(-1, 3) for M in (SCENE.N, SCENE.W))
    for sign, disagreement in ((2.0, 0.0), (-1.0, 1.0)):
        frames = replace(SCENE.trajectory, force=sign * force, torque=sign * torque)
        found = agreement(SCENE, PRIOR, frames)
        assert found.disagreement == pytest.approx(disagreement, abs=1e-12)
        assert found.torque_ratio == pytest.approx(max(sign, 0.0) / 2.0)


def test_where_nothing_is_expected_all_disagrees_that_is_measured():
    none = 0.0 * PRIOR
    frames = SCENE.trajectory
    assert agreement(SCENE, none, frames).disagreement == 1.0
    silent = replace(frames, force=0.0 * frames.force, torque=0.0 * frames.torque)
    assert agreement(SCENE, PRIOR, silent).disagreement == 0.0
    assert agreement(SCENE, none, silent).torque_ratio == 0.0


@pytest.mark.parametrize("factor", [1.0, 7.0])
def test_an_offset_is_found_beside_any_factor(factor):
    c = np.array([0.01, -0.03, 0.08])
    torque = factor * EXPECTED - np.cross(TURN @ c, FORCE)
    assert torque_offset(torque, EXPECTED, FORCE, TURN) == pytest.approx(c)
    assert torque_offset(factor * EXPECTED, EXPECTED, FORCE, TURN) == pytest.approx(
        np.zeros(3), abs=1e-12
    )


def test_pushes_along_one_axis_tell_nothing_along_it():
    force = 3.0 * TURN[:, :, 2]
    c = np.array([0.01, -0.03, 0.08])
    torque = -np.cross(TURN @ c, force)
    found = torque_offset(torque, np.zeros((N, 3)), force, TURN)
    assert found == pytest.approx([0.01, -0.03, 0.0])
