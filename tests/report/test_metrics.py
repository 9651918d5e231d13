"""A spring gives back all of its work, with friction or damping less of it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.kit import InputError, refuses, small_scene
from ttus_opt.report import metrics

SCENE = small_scene("trilinear", n_poses=20)
FIELD = tt.PotentialField(
    SCENE.voxmap, SCENE.voxmap.grid.unflatten(SCENE.laplace.solve(SCENE.b)), "trilinear"
)


def turned(vectors, degrees):
    """Each turned by an angle about an axis of its own across it."""
    across = np.cross(vectors, [0.3, -0.5, 0.8])
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    return Rotation.from_rotvec(np.deg2rad(degrees) * across).apply(vectors)


def test_known_errors_by_hand():
    """Measured: the rendered force doubled and turned by 30°, torque halved and by 50°.

    Angles of both are told over the frames above the thresholds only.
    """
    seen = metrics.evaluate(FIELD, SCENE.shell, SCENE.trajectory)
    force = 2.0 * turned(seen.rendered_force, 30.0)
    torque = 0.5 * turned(seen.rendered_torque, 50.0)
    measured = replace(SCENE.trajectory, force=force, torque=torque)
    errors = metrics.evaluate(
        FIELD, SCENE.shell, measured, force_threshold=0.2, torque_threshold=2e-4
    ).errors
    size = np.linalg.norm(seen.rendered_force, axis=1)
    assert errors.force_magnitude_error_N == pytest.approx(size.mean())
    assert errors.force_magnitude_rmse_N == pytest.approx(np.sqrt((size**2).mean()))
    # the third side of a triangle of 2, 1 and 30°, per frame, not per component
    side = np.sqrt(5.0 - 4.0 * np.cos(np.pi / 6))
    expected = side * np.sqrt((size**2).mean())
    assert errors.force_vector_rmse_N == pytest.approx(expected)
    assert errors.force_angle_error_deg == pytest.approx(30.0)
    twist = np.linalg.norm(seen.rendered_torque, axis=1)
    assert errors.torque_magnitude_error_Nm == pytest.approx(0.5 * twist.mean())
    rmse = 0.5 * np.sqrt((twist**2).mean())
    assert errors.torque_magnitude_rmse_Nm == pytest.approx(rmse)
    assert errors.torque_angle_error_deg == pytest.approx(50.0)
    touching = 2.0 * size > 0.2
    assert errors.frames_in_contact == touching.sum() > 3
    assert errors.frames_with_torque == (touching & (0.5 * twist > 2e-4)).sum() > 3


def test_the_default_thresholds_are_half_a_newton_and_a_hundredth_of_a_metre():
    """A frame just above counts, one just below does not; [N] and [N·m]."""
    force, torque = np.zeros((20, 3)), np.zeros((20, 3))
    force[:5, 0], force[5, 0] = 0.501, 0.499
    torque[:3, 1], torque[3, 1], torque[5, 1] = 0.0101, 0.0099, 1.0
    measured = replace(SCENE.trajectory, force=force, torque=torque)
    errors = metrics.evaluate(FIELD, SCENE.shell, measured).errors
    assert errors.frames_in_contact == 5
    assert errors.frames_with_torque == 3
    assert (errors.force_threshold_N, errors.torque_threshold_Nm) == (0.5, 0.01)


def test_angles_are_exact_when_small_and_right_for_zeros():
    a = np.array([[1.0, 0, 0], [1, 0, 0], [0, 0, 0], [1, 0, 0]])
    b = np.array([[1.0, 1e-9, 0], [-1, 0, 0], [1, 0, 0], [0, 0, 0]])
    expected = [np.degrees(1e-9), 180.0, 90.0, 90.0]
    np.testing.assert_allclose(metrics.angles(a, b), expected, rtol=1e-9)


def test_errors_are_told_in_short():
    """Torque in thousandths of a N·m."""
    force, torque = np.zeros((20, 3)), np.zeros((20, 3))
    force[:5, 0], torque[:5, 1] = 2.0, 0.02
    wrench = np.zeros((20, 6))
    wrench[:5, 1], wrench[:5, 5] = 3.0, 0.06
    measured = replace(SCENE.trajectory, force=force, torque=torque)
    errors = metrics.compare(measured, metrics.as_rendered(wrench)).errors
    assert repr(errors) == (
        "Errors(force 0.25 N, 90.0°; torque 10 mN m, 90.0°; 20 frames, 5 in contact)"
    )


def test_no_frame_in_contact_has_no_angle():
    still = replace(SCENE.trajectory, force=np.zeros((20, 3)))
    errors = metrics.evaluate(FIELD, SCENE.shell, still).errors
    assert errors.frames_in_contact == 0
    assert np.isnan(errors.force_angle_error_deg)


def test_the_share_told_apart_counts_frames_with_a_force_of_either():
    """By hand: 0.36 N is felt, and 18° where the measured force has a direction."""
    x, y = np.eye(3)[:2]
    force, force_hat = np.zeros((20, 3)), np.zeros((20, 3))
    force[:6] = [2.0 * x, 2.0 * x, 2.0 * x, 0.0 * x, 0.45 * x, 0.45 * x]
    force_hat[:6] = [2.1 * x, 2.5 * x, 2.0 * y, 0.9 * x, 0.0 * x, 0.55 * y]
    # of five forces above 0.5 N three are told apart: too strong, aslant, in the air;
    # the fifth is below it on both sides, the last is measured without a direction
    wrench = np.column_stack([force_hat, np.zeros((20, 3))])
    measured = replace(SCENE.trajectory, force=force, torque=np.zeros((20, 3)))
    errors = metrics.compare(measured, metrics.as_rendered(wrench)).errors
    assert errors.share_told_apart == pytest.approx(3 / 5)
    assert errors.frames_in_contact == 3


def test_a_trajectory_without_wrench_is_refused():
    bare = replace(SCENE.trajectory, force=None, torque=None)
    refuses(InputError, "no wrench", metrics.evaluate, FIELD, SCENE.shell, bare)


def test_some_frames_are_judged_as_if_recorded_alone():
    measured = replace(SCENE.trajectory, force=np.full((20, 3), 0.7))
    own = np.arange(20) % 3 == 0
    whole = metrics.evaluate(FIELD, SCENE.shell, measured, force_threshold=1.0)
    part = whole.over(own)
    alone = metrics.evaluate(
        FIELD, SCENE.shell, measured.select(own), force_threshold=1.0
    )
    assert part.errors == alone.errors != whole.errors
    np.testing.assert_array_equal(part.time, alone.time)
    np.testing.assert_array_equal(part.rendered_force, alone.rendered_force)
    np.testing.assert_array_equal(part.rendered_torque, alone.rendered_torque)


@pytest.mark.parametrize(
    ("measured", "rendered", "degrees", "felt"),
    [
        (10.0, 10.69, 0.0, False),  # 6.9 % of 10 N
        (10.0, 10.71, 0.0, True),
        (10.0, 9.29, 0.0, True),
        (2.0, 2.35, 0.0, False),  # 17 %, and below 0.36 N
        (2.0, 2.37, 0.0, True),
        (0.0, 0.37, 0.0, True),
        (10.0, 10.0, 17.9, False),
        (10.0, 10.0, 18.1, True),
    ],
)
def test_limits_of_magnitude_and_direction(measured, rendered, degrees, felt):
    force, force_hat = (np.array([[0.0, size, 0.0]]) for size in (measured, rendered))
    found = metrics.noticeable(force, force_hat, np.array([degrees]))
    assert found.tolist() == [felt]


SHELL = tt.PointShell.from_spec("sphere:0.01")
STIFFNESS = 800.0
TIME = np.arange(200) / 20.0
DEPTH = 0.008 * np.sin(2.0 * np.pi * TIME / 5.0)  # two presses, lifted in between


def presses(lost=0.0, depth=DEPTH):
    """A spring along y, weaker by a share on the way out."""
    touching = np.maximum(depth, 0.0)
    leaving = np.gradient(depth) < 0.0
    size = STIFFNESS * touching * np.where(leaving, 1.0 - lost, 1.0)
    force = np.outer(size, [0.0, 1.0, 0.0])
    position = np.outer(-depth, [0.0, 1.0, 0.0])
    n = len(depth)
    return tt.Trajectory(TIME[:n], position, np.tile(np.eye(3), (n, 1, 1)), force)


@pytest.mark.parametrize(("lost", "within"), [(0.0, 1e-9), (0.1, 0.03), (0.4, 0.03)])
def test_share_is_what_is_missing_on_the_way_out(lost, within):
    found = metrics.hysteresis_share(presses(lost), SHELL, 0.5)
    assert found == pytest.approx(lost, abs=within)


def test_a_turn_against_a_torque_is_work_too():
    recording = presses()
    angle = 0.3 * np.sin(2.0 * np.pi * TIME / 5.0)
    cos, sin, no = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    rotation = np.stack([cos, -sin, no, sin, cos, no, no, no, no + 1.0], axis=1)
    rate = np.gradient(angle, TIME)
    torque = np.outer(-0.05 * rate, [0.0, 0.0, 1.0])  # a damper alone
    turned = tt.Trajectory(
        TIME,
        np.zeros((len(TIME), 3)),
        rotation.reshape(-1, 3, 3),
        recording.force,
        torque,
    )
    assert metrics.hysteresis_share(turned, SHELL, 0.5) == pytest.approx(1.0, abs=1e-6)


def test_nothing_is_told_where_no_press_is_complete():
    middle = presses(0.4).select(slice(10, 40))
    assert np.isnan(metrics.hysteresis_share(middle, SHELL, 0.5))
    bare = tt.Trajectory(middle.time, middle.position, middle.rotation)
    refuses(InputError, "forces", metrics.hysteresis_share, bare, SHELL, 0.5)
