"""Poses as ROS and others have them give the frame of their rotation matrix."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.kit import InputError, deepest_pose, pressing, refuses
from ttus_opt.haptic.renderer import Renderer
from ttus_opt.haptic.wrench import orthonormalise
from ttus_opt.probe.pose import rotations

RNG = np.random.default_rng(4)


def test_every_form_of_a_pose_gives_the_same_frame(scene):
    renderer = Renderer(pressing(scene), scene.shell)
    R, at = deepest_pose(scene)
    turn, whole = Rotation.from_matrix(R), np.eye(4)
    whole[:3, :3], whole[:3, 3] = R, at
    expected, out = renderer.render(R, at), np.zeros(6)
    assert expected.contact_points > 0
    forms = [
        ((whole, None), {}),
        ((turn, at), {}),
        ((turn.as_quat(), at), {"order": "xyzw"}),
        ((turn.as_quat(scalar_first=True), at.tolist()), {"order": "wxyz"}),
        ((R.astype(np.float64).tolist(), at), {}),
    ]
    for pose, named in forms:
        force = renderer.render(*pose, **named).force
        np.testing.assert_allclose(force, expected.force, atol=1e-9)
        assert renderer.render_into(*pose, out, **named) == expected.contact_points
        np.testing.assert_array_equal(out[:3], force)
    np.testing.assert_array_equal(renderer.render(whole).force, expected.force)


def test_a_rounded_matrix_renders_as_the_rotation_nearest_to_it(scene):
    """And its caller's matrix is left alone."""
    renderer = Renderer(pressing(scene), scene.shell)
    R, at = deepest_pose(scene)
    for rounded in (R.astype(np.float32), R + 1e-6 * RNG.uniform(-1, 1, (3, 3))):
        kept = rounded.copy()
        found = renderer.render(rounded, at)
        np.testing.assert_array_equal(rounded, kept)
        nearest = renderer.render(rotations(rounded.astype(float)), at)
        np.testing.assert_allclose(found.force, nearest.force, atol=1e-10)
        np.testing.assert_allclose(found.torque, nearest.torque, atol=1e-12)


@pytest.mark.parametrize("noise", [1e-16, 1e-9, 1e-6, 2e-6])
def test_compiled_and_plain_rounding_agree(noise):
    for exact in Rotation.random(50, rng=RNG).as_matrix():
        rounded = exact + noise * RNG.uniform(-1, 1, (3, 3))
        found = rounded.copy()
        assert orthonormalise(found)
        np.testing.assert_allclose(found, rotations(rounded), rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.T @ found, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e9])
def test_a_bad_entry_anywhere_is_no_rotation(value):
    exact = Rotation.from_rotvec([0.3, 0.5, -0.2]).as_matrix()
    for entry in range(9):
        matrix = exact.copy()
        matrix.flat[entry] = value
        assert not orthonormalise(matrix)
    for wrong in (1.01 * exact, exact * [1.0, 1.0, -1.0], np.zeros((3, 3))):
        assert not orthonormalise(wrong)


@pytest.mark.parametrize(
    ("rotation", "named", "word"),
    [
        (np.array([0.0, 0.0, 0.0, 1.0]), {}, "order='wxyz' or order='xyzw'"),
        (np.eye(3), {"order": "wxyz"}, "of a quaternion"),
        (1.0001 * np.eye(3), {}, "orthonormal"),
        (np.eye(3) + 1e-4 * np.eye(3)[[1, 2, 0]], {}, "orthonormal"),
        (np.diag([1.0, 1.0, -1.0]).astype(np.float32), {}, "reflection"),
    ],
)
def test_other_poses_are_refused(scene, rotation, named, word):
    renderer = Renderer(pressing(scene), scene.shell)
    for call in (renderer.render, lambda *a, **k: renderer.render_into(*a, OUT, **k)):
        refuses(InputError, word, call, rotation, np.zeros(3), **named)


OUT = np.zeros(6)
