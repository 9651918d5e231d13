"""Poses in the forms of others; rounding is undone, anything more is refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.kit import InputError, refuses
from ttus_opt.probe.pose import (
    EXACT,
    from_quaternions,
    pose_of,
    rotations,
    to_quaternions,
)

RNG = np.random.default_rng(3)
TURN = Rotation.from_rotvec([0.3, -1.2, 0.7])
R, AT = TURN.as_matrix(), np.array([0.1, -0.2, 0.3])
WHOLE = np.block([[R, AT[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])


@pytest.mark.parametrize(
    "given",
    [
        (R, AT),
        (R.tolist(), AT.tolist()),
        (TURN, AT),
        (WHOLE,),
        (TURN.as_quat(), AT, "xyzw"),
        (TURN.as_quat(scalar_first=True), AT, "wxyz"),
        (-1.005 * TURN.as_quat(), AT, "xyzw"),
    ],
)
def test_all_forms_are_the_same_pose(given):
    pose = pose_of(*given)
    np.testing.assert_allclose(pose.rotation, R, atol=1e-15)
    np.testing.assert_array_equal(pose.position, AT)


def test_a_rigid_transform_is_a_whole_pose():
    transform = pytest.importorskip("scipy.spatial.transform")
    if not hasattr(transform, "RigidTransform"):
        pytest.skip("this SciPy has no RigidTransform")
    pose = pose_of(transform.RigidTransform.from_components(AT, TURN))
    np.testing.assert_allclose(pose.rotation, R, atol=1e-15)
    np.testing.assert_array_equal(pose.position, AT)


@pytest.mark.parametrize(
    ("given", "word"),
    [
        ((WHOLE, AT), r"matrix \(4, 4\) alone"),
        ((WHOLE.T,), "ends in the row 0, 0, 0, 1.*transposed"),
        ((R,), "no position"),
        ((R, AT[:2]), r"position \(3,\)"),
        ((R[None], AT), r"got rotation \(1, 3, 3\)"),
        ((Rotation.random(2, rng=RNG), AT), r"\(2, 3, 3\)"),
        ((TURN.as_quat(), AT), "order='wxyz' or order='xyzw'"),
        ((TURN.as_quat(), AT, "wzyx"), "got 'wzyx'"),
        ((R, AT, "wxyz"), r"of a quaternion \(4,\)"),
        ((1.02 * TURN.as_quat(), AT, "xyzw"), "length 1.02, expected 1"),
        ((1e300 * TURN.as_quat(), AT, "xyzw"), "length inf, expected 1"),
        ((np.full(4, np.nan), AT, "xyzw"), "length nan"),
        ((np.zeros(4), AT, "xyzw"), "length 0"),
    ],
)
def test_other_forms_are_refused(given, word):
    refuses(InputError, word, pose_of, *given)


def test_rounding_is_undone_to_the_nearest_rotation():
    """float32, seven digits, and errors just below the limit, against the SVD."""
    exact = Rotation.random(200, rng=RNG).as_matrix()
    noise = 1e-6 * RNG.uniform(-1, 1, exact.shape)
    for rounded in (exact.astype(np.float32), exact.round(7), exact + noise):
        found = rotations(np.asarray(rounded, dtype=float))
        U, _, Vt = np.linalg.svd(rounded.astype(float))
        np.testing.assert_allclose(found, U @ Vt, atol=2e-11)
        gram = found.transpose(0, 2, 1) @ found
        np.testing.assert_allclose(
            gram, np.broadcast_to(np.eye(3), gram.shape), atol=EXACT
        )


def test_exact_rotations_are_left_as_they_are():
    exact = Rotation.random(20, rng=RNG).as_matrix()
    assert rotations(exact) is exact


@pytest.mark.parametrize(
    ("matrix", "word"),
    [
        (1.00001 * R, "orthonormal"),
        (R + 3e-5 * np.ones((3, 3)), "orthonormal"),
        (-R, "reflection"),
        (R @ np.diag([1.0, 1.0, -1.0]), "reflection"),
        (np.where(np.eye(3) > 0, np.nan, R), "NaN"),
    ],
)
def test_no_rotation_is_refused_and_its_frame_told(matrix, word):
    refuses(InputError, word, rotations, matrix)
    if word != "NaN":
        refuses(InputError, f"frame 2: .*{word}", rotations, np.stack([R, R, matrix]))


def test_quaternions_there_and_back():
    quaternions = Rotation.random(20, rng=RNG).as_quat(
        canonical=True, scalar_first=True
    )
    again = to_quaternions(from_quaternions(quaternions, "wxyz"))
    np.testing.assert_allclose(again, quaternions, atol=1e-15)
