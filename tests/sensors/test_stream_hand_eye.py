"""A camera's pose from two streams, against one that is known."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.kit import GeometryError, InputError, refuses
from ttus_opt.probe.pose import rotations
from ttus_opt.probe.rigid_motion import homogeneous, inverse
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.sensors.hand_eye import hand_eye, read_pose_pairs, solved
from ttus_opt.sensors.stream_files import read_poses
from ttus_opt.sensors.stream_hand_eye import stream_hand_eye
from ttus_opt.sensors.stream_pairs import aligned, offset_by_angles

CAMERA = homogeneous(
    Rotation.from_rotvec([2.0, 0.5, -1.0]).as_matrix(), [1.2, -0.3, 0.8]
)
MARKER = homogeneous(
    Rotation.from_rotvec([0.1, 1.0, 0.4]).as_matrix(), [0.02, 0.05, 0.1]
)
LATE = 0.83


#: A real arm with its camera; source and licence are beside it
REAL = Path(__file__).parent / "real_hand_eye"


pytestmark = pytest.mark.filterwarnings("ignore:.*no header")


def hand(time, axes=3):
    """Waving in all directions, or about some axes only."""
    t = time[:, None]
    turn = 0.6 * np.sin(t * [0.9, 1.3, 0.7] + [0.0, 1.0, 2.0])
    turn += 0.2 * np.sin(t * [2.9, 2.1, 3.3])
    turn[:, axes:] = 0.0
    place = 0.15 * np.sin(t * [0.8, 0.5, 1.1] + [2.0, 0.0, 1.0]) + [0.5, 0, 0.4]
    return homogeneous(Rotation.from_rotvec(turn).as_matrix(), place)


def noisy(motion, time, turn, shift, seed):
    rng = np.random.default_rng(seed)
    errs = Rotation.from_rotvec(rng.normal(0, max(turn, 1e-15), (len(time), 3)))
    rotation = errs.as_matrix() @ motion[:, :3, :3]
    place = motion[:, :3, 3] + rng.normal(0, max(shift, 1e-15), (len(time), 3))
    return Trajectory(time, place, rotation)


def streams(
    seed=0, *, fixed=True, turn=0.003, shift=5e-4, outliers=0.0, axes=3, seconds=10.0
):
    """A marker in a camera at 30 Hz, the hand at 50 Hz on a clock that is behind."""
    time = np.arange(0.0, seconds, 1 / 30)
    B = hand(time, axes)
    X, Z = CAMERA, MARKER
    seen = inverse(X) @ B @ Z if fixed else inverse(B @ X) @ Z
    rng = np.random.default_rng(seed + 100)
    wild = rng.random(len(time)) < outliers
    flip = Rotation.random(len(time), random_state=seed).as_matrix()
    seen[wild, :3, :3] = flip[wild]
    seen[wild, :3, 3] += rng.normal(0, 0.2, (wild.sum(), 3))
    own = np.arange(0.0, seconds - 1.0, 0.02)
    other = noisy(hand(own + LATE, axes), own, 2e-4, 1e-4, seed + 50)
    return noisy(seen, time, turn, shift, seed), other


@pytest.mark.slow
@pytest.mark.parametrize("fixed", [True, False])
def test_exact_poses_give_the_exact_camera(fixed):
    """Up to the interpolation of the hand's poses between 100 Hz."""
    found = stream_hand_eye(
        *streams(fixed=fixed, turn=0.0, shift=0.0),
        "fixed" if fixed else "moving",
        around=0.8,
        largest=0.4,
    )
    np.testing.assert_allclose(found.camera, CAMERA, atol=3e-4)
    np.testing.assert_allclose(found.marker, MARKER, atol=3e-4)
    assert found.offset == pytest.approx(LATE, abs=1e-3)


@pytest.mark.slow
def test_outliers_and_noise():
    """A quarter of all frames is wrong altogether."""
    found = stream_hand_eye(*streams(outliers=0.25), "fixed", around=0.8, largest=0.4)
    off = inverse(CAMERA) @ found.camera
    assert np.linalg.norm(off[:3, 3]) < 2e-3
    assert Rotation.from_matrix(off[:3, :3]).magnitude() < 2e-3
    assert found.outliers > 60
    assert found.loop.gap == pytest.approx(0.0013, rel=0.5)


@pytest.mark.slow
def test_the_covariance_is_that_of_repetitions():
    """Squared errors by the stated covariance are χ² of six degrees, 12 times."""
    squares, lates = [], []
    for seed in range(12):
        found = stream_hand_eye(*streams(seed, seconds=25.0), "fixed")
        turn = Rotation.from_matrix(found.camera[:3, :3] @ CAMERA[:3, :3].T)
        off = np.r_[turn.as_rotvec(), found.camera[:3, 3] - CAMERA[:3, 3]]
        squares.append(off @ np.linalg.solve(found.covariance, off))
        lates.append((found.offset - LATE) / found.offset_std)
    # the mean of 12 of them has a standard deviation of 1
    assert 3.0 < np.mean(squares) < 9.0
    assert 0.6 < np.std(lates) < 1.5


def test_a_known_offset_is_kept():
    found = stream_hand_eye(*streams(), "fixed", offset=LATE)
    assert found.offset == LATE
    assert np.linalg.norm(found.camera[:3, 3] - CAMERA[:3, 3]) < 2e-3


def test_motions_that_tell_nothing():
    with pytest.raises(GeometryError, match="about one axis"):
        stream_hand_eye(*streams(axes=1), "fixed", offset=LATE)
    seen, other = streams()
    still = Trajectory(seen.time, seen.position, seen.rotation[[0] * len(seen)])
    with pytest.raises((InputError, GeometryError)):
        stream_hand_eye(still, other, "fixed", offset=LATE)


def test_streams_of_other_bodies_or_times():
    seen, _ = streams()
    _, other = streams()
    with pytest.raises(InputError, match="do not overlap"):
        stream_hand_eye(seen, other, "fixed", offset=500.0)
    refuses(InputError, "camera must be", stream_hand_eye, seen, other, "hand")
    wrong = Trajectory(other.time, other.position, other.rotation[::-1].copy())
    refuses(InputError, "", stream_hand_eye, seen, wrong, "fixed", offset=LATE)


def test_the_wrong_place_of_the_camera_is_named():
    """A fixed camera taken for a moving one, and poses that are inverted."""
    seen, other = streams(seconds=3.0)
    refuses(
        InputError, "camera=fixed", stream_hand_eye, seen, other, "moving", offset=LATE
    )
    turned = seen.rotation.swapaxes(1, 2)
    back = np.einsum("nij,nj->ni", turned, -seen.position)
    camera = Trajectory(seen.time, back, turned.copy())
    refuses(
        InputError,
        "give inverted=True",
        stream_hand_eye,
        camera,
        other,
        "fixed",
        offset=LATE,
    )
    found = stream_hand_eye(camera, other, "fixed", inverted=True, offset=LATE)
    assert np.linalg.norm(found.camera[:3, 3] - CAMERA[:3, 3]) < 2e-3


@pytest.mark.parametrize("near", [-0.15, 0.0, 0.2])
def test_angles_between_instants_tell_the_offset(near):
    """From a poor one, with a quarter of outliers; 2 ms is the step."""
    seen, other = streams(outliers=0.25, seconds=6.0)
    assert offset_by_angles(seen, other, LATE + near) == pytest.approx(LATE, abs=3e-3)


def test_poses_of_a_real_arm_agree_with_other_solvers(shared):
    """Fifty pairs of a camera beside an arm, given times; two methods, 5 mm."""
    file = shared / "markers" / "handeye" / "pose_samples.json"
    A, B = read_pose_pairs(file)
    time = 0.1 * np.arange(len(A))
    seen, carried = (
        Trajectory(time, poses[:, :3, 3].copy(), rotations(poses[:, :3, :3]))
        for poses in (A, B)
    )
    found = stream_hand_eye(seen, carried, "fixed", offset=0.0)
    expected = hand_eye(A, B, "fixed").camera
    off = inverse(expected) @ found.camera
    assert np.linalg.norm(off[:3, 3]) < 5e-3
    assert Rotation.from_matrix(off[:3, :3]).magnitude() < np.deg2rad(0.3)
    assert found.loop.gap < 5e-3


def real(late=0.0):
    """Camera in target and hand in base, on clocks of their own."""
    seen, carried = (
        read_poses(REAL / name) for name in ("camera_in_target.csv", "hand_in_base.csv")
    )
    return seen, Trajectory(carried.time - late, carried.position, carried.rotation)


def between(poses, begin, end):
    return poses.select((poses.time >= begin) & (poses.time <= end))


def test_a_real_arm_with_a_colour_camera():
    """Loops close to 3 mm and 0.5°, and OpenCV's best solver says the same."""
    seen, carried = real(late=1.3)
    found = stream_hand_eye(seen, carried, "moving", inverted=True)
    assert found.median_gap < 3.1e-3
    assert found.median_twist < np.deg2rad(0.5)
    # 16 ms are between the clocks as recorded
    assert found.offset == pytest.approx(1.316, abs=0.005)
    _, E, B = aligned(seen, carried, found.offset)
    rows = np.arange(0, len(E), 4)
    others = solved(B[rows], inverse(E[rows])).values()
    best = min(others, key=lambda other: other.loop.gap)
    off = inverse(found.camera) @ best.camera
    assert np.linalg.norm(off[:3, 3]) < 6e-3
    assert Rotation.from_matrix(off[:3, :3]).magnitude() < np.deg2rad(0.4)


@pytest.mark.slow
def test_halves_of_a_real_recording_agree_within_their_covariance():
    """Squared differences are χ² of six degrees: above 20 once in 400."""
    seen, carried = real()
    middle, far = seen.time.mean(), 1e4
    first, second = (
        stream_hand_eye(
            between(seen, middle + begin, middle + end),
            between(carried, middle + begin, middle + end),
            "moving",
            inverted=True,
        )
        for begin, end in ((-far, 0.0), (0.0, far))
    )
    turn = Rotation.from_matrix(first.camera[:3, :3] @ second.camera[:3, :3].T)
    off = np.r_[turn.as_rotvec(), first.camera[:3, 3] - second.camera[:3, 3]]
    assert off @ np.linalg.solve(first.covariance + second.covariance, off) < 20.0
    assert first.shift_std.max() < 0.006


def test_a_real_stretch_about_one_axis_is_refused():
    seen, carried = real()
    begin = seen.time[0]
    part = [between(poses, begin + 14.0, begin + 28.0) for poses in (seen, carried)]
    with pytest.raises(GeometryError, match="tilted about two axes"):
        stream_hand_eye(*part, "moving", inverted=True)
