from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.errors import InputError
from ttus_opt.field import PotentialField
from ttus_opt.metrics import angles, evaluate
from ttus_opt.renderer import Renderer

SCENE = small_scene("trilinear", n_poses=20)
FIELD = PotentialField(
    SCENE.voxmap, SCENE.voxmap.grid.unflatten(SCENE.laplace.solve(SCENE.b)), "trilinear"
)


def test_rendered_series_is_the_renderers() -> None:
    evaluation = evaluate(FIELD, SCENE.shell, SCENE.trajectory)
    renderer = Renderer(FIELD, SCENE.shell)
    for t in range(20):
        wrench = renderer.render(
            SCENE.trajectory.rotation[t], SCENE.trajectory.position[t]
        )
        np.testing.assert_allclose(
            evaluation.rendered_force[t], wrench.force, atol=1e-12
        )
        np.testing.assert_allclose(
            evaluation.rendered_torque[t], wrench.torque, atol=1e-13
        )


def test_a_perfect_field_has_no_error() -> None:
    seen = evaluate(FIELD, SCENE.shell, SCENE.trajectory)
    perfect = replace(
        SCENE.trajectory, force=seen.rendered_force, torque=seen.rendered_torque
    )
    errors = evaluate(FIELD, SCENE.shell, perfect, force_threshold=0.01).errors
    assert errors.force_magnitude_error_N < 1e-14
    assert errors.force_angle_error_deg < 1e-6
    assert errors.torque_magnitude_error_Nm < 1e-14
    assert errors.frames == 20
    assert 0 < errors.frames_in_contact <= 20


def test_known_errors_by_hand() -> None:
    """Twice the force, turned by 30° about z; half the torque."""
    seen = evaluate(FIELD, SCENE.shell, SCENE.trajectory)
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    flat = seen.rendered_force * [1, 1, 0]
    renderable = replace(
        SCENE.trajectory,
        force=2 * seen.rendered_force,
        torque=0.5 * seen.rendered_torque,
    )
    errors = evaluate(FIELD, SCENE.shell, renderable).errors
    size = np.linalg.norm(seen.rendered_force, axis=1)
    assert errors.force_magnitude_error_N == pytest.approx(size.mean())
    assert errors.force_magnitude_rmse_N == pytest.approx(np.sqrt((size**2).mean()))
    torque = np.linalg.norm(seen.rendered_torque, axis=1)
    assert errors.torque_magnitude_error_Nm == pytest.approx(0.5 * torque.mean())
    touched = size > 0.1
    np.testing.assert_allclose(angles(flat[touched], flat[touched] @ turn.T), 30.0)


def test_angles_are_exact_when_small_and_right_for_zeros() -> None:
    a = np.array([[1.0, 0, 0], [1, 0, 0], [0, 0, 0], [1, 0, 0]])
    b = np.array([[1.0, 1e-9, 0], [-1, 0, 0], [1, 0, 0], [0, 0, 0]])
    expected = [np.degrees(1e-9), 180.0, 90.0, 90.0]
    np.testing.assert_allclose(angles(a, b), expected, rtol=1e-9)


def test_no_frame_in_contact_has_no_angle() -> None:
    still = replace(SCENE.trajectory, force=np.zeros((20, 3)))
    errors = evaluate(FIELD, SCENE.shell, still).errors
    assert errors.frames_in_contact == 0
    assert np.isnan(errors.force_angle_error_deg)


def test_a_trajectory_without_wrench_is_refused() -> None:
    bare = replace(SCENE.trajectory, force=None, torque=None)
    with pytest.raises(InputError, match="no wrench"):
        evaluate(FIELD, SCENE.shell, bare)
