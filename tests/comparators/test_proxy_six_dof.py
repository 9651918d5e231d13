"""The constrained proxy against a half-space and a general solver."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.comparators.contacts import made as on_torso
from tests.comparators.recordings import facing
from tests.comparators.walls import block, pressed, wall
from tests.kit import torso
from ttus_opt.comparators.proxy_six_dof import ProxySixDof, least_motion


def test_six_dof_lifts_a_block_straight_out_of_a_half_space():
    made = ProxySixDof(surface=wall(), shell=block(400))
    unit, _ = made._unit_wrench(*pressed(0.003))
    np.testing.assert_allclose(unit[0], 0.003, rtol=0.02)
    np.testing.assert_allclose(unit[1:3], 0.0, atol=1e-4)


def test_six_dof_leaves_no_point_below_the_surface():
    made = on_torso(ProxySixDof)
    R, at = facing(torso(), 1.4, 0.1, 0.008)
    R = R @ Rotation.from_rotvec([0.3, 0.2, 0.0]).as_matrix()
    unit, _ = made._unit_wrench(R, at)
    turn = Rotation.from_rotvec(unit[3:] / made.shell.rms_radius**2).as_matrix()
    points = made.shell.points @ (turn @ R).T + at + unit[:3]
    depth, _ = made.geometry.surface.depth(points)
    assert depth.max() < 1e-4
    assert np.sort(depth)[-3:].min() > -1e-3  # and touches


def test_the_least_motion_is_that_of_a_general_solver():
    from scipy.optimize import minimize

    rng = np.random.default_rng(2)
    for _ in range(5):
        rows = rng.normal(size=(8, 6)) + np.eye(6)[0]
        least = rng.uniform(-0.5, 1.0, 8)
        found = minimize(
            lambda x: 0.5 * x @ x,
            np.zeros(6),
            jac=lambda x: x,
            constraints={"type": "ineq", "fun": lambda x, r=rows, b=least: r @ x - b},
            method="SLSQP",
            options={"ftol": 1e-12, "maxiter": 500},
        )
        np.testing.assert_allclose(least_motion(rows, least), found.x, atol=1e-6)


def test_contradictions_give_way_like_springs():
    rows = np.array([[1.0, 0.0], [-1.0, 0.0]])
    motion = least_motion(rows, np.array([2.0, 1.0]))
    # min ½x² + ½((2 − x)² + (1 + x)²)/SOFT²
    soft = 0.3**-2
    assert motion[0] == pytest.approx(soft / (1.0 + 2.0 * soft), rel=1e-6)


def test_where_no_point_is_below_the_surface_nothing_moves():
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(8, 6)) + np.eye(6)[0]
    for least in (-rng.uniform(0.1, 1.0, 8), np.zeros(8)):
        assert not least_motion(rows, least).any()


def test_six_dof_turns_by_the_moment_of_its_force():
    """Where one spot touches, the torque is its lever times the force."""
    made = on_torso(ProxySixDof)
    R, at = facing(torso(), 1.4, 0.1, 0.002)
    R = R @ Rotation.from_rotvec([0.5, 0.4, 0.0]).as_matrix()
    unit, _ = made._unit_wrench(R, at)
    arm = (made.shell.points - made.shell.reference) @ R.T
    depth, _ = made.geometry.surface.depth(made.shell.points @ R.T + at)
    moment = np.cross(arm[depth.argmax()], unit[:3])
    assert np.linalg.norm(moment) > 0.0
    off = np.linalg.norm(unit[3:] - moment)
    assert off < 0.2 * np.linalg.norm(moment), off / np.linalg.norm(moment)
