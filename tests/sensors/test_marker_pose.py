"""Poses of markers: drawn ones with a known answer, and photos."""

import json

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.kit import FileError, InputError, TtusWarning, refuses
from ttus_opt.sensors.intrinsics import Intrinsics
from ttus_opt.sensors.marker_pose import (
    Board,
    MarkerPose,
    board_pose,
    marker_poses,
    read_image,
)

CAMERA = Intrinsics(
    np.array([[600.0, 0, 320], [0, 610.0, 240], [0, 0, 1]]), np.zeros(0), (640, 480)
)

#: The board of the photo
PHOTO = Board(3, 4, 0.0256, 0.0066, "4X4_250")

PHOTO_CAMERA = Intrinsics(
    np.array([[618.600, 0, 321.984], [0, 619.110, 241.146], [0, 0, 1]]), np.zeros(0)
)

TAG_CAMERA = Intrinsics(
    np.array(
        [
            [338.563277422543, 0.0, 336.45495347495824],
            [0.0, 338.939280638548, 230.486982216255],
            [0.0, 0.0, 1.0],
        ]
    ),
    np.zeros(0),
    (640, 480),
)


def looking(turn, shift):
    """A marker turned towards the camera, then by a rotation vector [rad, m]."""
    pose = np.eye(4)
    facing = np.diag([1.0, -1.0, -1.0])
    pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ facing
    pose[:3, 3] = shift
    return pose


def drawn(pose, side=0.06):
    """A photo of AprilTag 7 at a pose, antialiased."""
    cells, scale = 10, 40  # a white rim of one cell
    tags = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    tag = np.full((cells * scale,) * 2, 255, np.uint8)
    tag[scale:-scale, scale:-scale] = cv2.aruco.generateImageMarker(tags, 7, 8 * scale)
    # texture [pixel] → marker [m] → image, drawn four times finer than it will be
    metre = side / (8 * scale)
    middle = cells * scale / 2 - 0.5
    to_marker = np.array(
        [[metre, 0, -middle * metre], [0, -metre, middle * metre], [0, 0, 1]]
    )
    fine = np.array([[4.0, 0, 1.5], [0, 4.0, 1.5], [0, 0, 1]])
    H = fine @ CAMERA.matrix @ pose[:3, [0, 1, 3]] @ to_marker
    large = cv2.warpPerspective(tag, H, (2560, 1920), borderValue=200)
    return cv2.resize(large, (640, 480), interpolation=cv2.INTER_AREA)


@pytest.mark.parametrize(
    ("turn", "shift"),
    [([0.6, 0.1, 0.2], [0.02, -0.01, 0.35]), ([-0.3, 0.7, 1.5], [-0.05, 0.04, 0.4])],
)
def test_a_drawn_marker_is_found_where_it_is(turn, shift):
    truth = looking(turn, shift)
    (found,) = marker_poses(drawn(truth), 0.06, "APRILTAG_36H11", CAMERA)
    assert found.markers == (7,)
    error = found.pose[:3, 3] - truth[:3, 3]
    apart = Rotation.from_matrix(found.pose[:3, :3] @ truth[:3, :3].T)
    assert np.linalg.norm(error) < 0.002
    assert apart.magnitude() < np.deg2rad(1.0)
    assert found.residual < 0.3
    assert found.other_residual > 2 * found.residual


def test_the_covariance_is_that_of_many_noisy_photos():
    rng = np.random.default_rng(1)
    truth = looking([0.5, 0.3, 0.1], [0.02, 0.01, 0.3])
    points = 0.03 * np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    points = np.vstack([points + np.array([0.08 * i, 0, 0]) for i in range(6)])
    turn = Rotation.from_matrix(truth[:3, :3]).as_rotvec()
    exact = cv2.projectPoints(points, turn, truth[:3, 3], CAMERA.matrix, None)[0]
    from ttus_opt.sensors.marker_pose import _refined

    start = (turn[:, None], truth[:3, 3:])
    found = [
        _refined((0,), points, pixels, CAMERA, start)
        for pixels in exact.reshape(1, -1, 2) + rng.normal(0, 0.5, (400, 24, 2))
    ]
    turns = [
        Rotation.from_matrix(one.pose[:3, :3] @ truth[:3, :3].T).as_rotvec()
        for one in found
    ]
    shifts = [one.pose[:3, 3] for one in found]
    sampled = np.cov(np.hstack([turns, shifts]).T)
    told = np.mean([one.covariance for one in found], axis=0)
    scale = np.sqrt(np.diag(told))
    np.testing.assert_allclose(
        sampled / np.outer(scale, scale), told / np.outer(scale, scale), atol=0.2
    )


def test_the_photo_of_a_board(shared):
    image = read_image(shared / "markers" / "aruco_photo.png")
    found = board_pose(image, PHOTO, PHOTO_CAMERA)
    assert found.markers == tuple(range(12))
    assert found.residual <= 1.0
    assert found.pose[2, 3] == pytest.approx(0.4915, abs=0.003)
    assert found.shift_std.max() < 0.001


def test_a_board_with_columns_and_rows_swapped_is_refused(shared):
    image = read_image(shared / "markers" / "aruco_photo.png")
    swapped = Board(4, 3, 0.0256, 0.0066, "4X4_250")
    with pytest.raises(InputError, match=r"41\.9 pixels.*3 columns and 4 rows") as told:
        board_pose(image, swapped, PHOTO_CAMERA)
    assert "it is 0.47" in str(told.value)


def test_a_board_that_fits_badly_is_told(shared):
    image = read_image(shared / "markers" / "aruco_photo.png")
    wide = Board(3, 4, 0.0256, 0.0100, "4X4_250")
    with pytest.warns(TtusWarning, match="pixels off"):
        found = board_pose(image, wide, PHOTO_CAMERA)
    assert 2.0 < found.residual < 5.0


#: OpenCV 4.10 overlooks the smallest tag of the first photo
FIRST = 3 if cv2.__version__.startswith("4.10.") else 4


@pytest.mark.parametrize(("photo", "least"), [(1, FIRST), (2, 5), (3, 6)])
@pytest.mark.filterwarnings("ignore::ttus_opt.core.errors.TtusWarning")
def test_photos_of_april_tags(shared, photo, least):
    image = read_image(shared / "markers" / f"test_image_multiple_0{photo}.png")
    found = marker_poses(image, 0.065, "APRILTAG_36H11", TAG_CAMERA)
    assert len(found) >= least
    for pose in found:
        assert pose.residual <= 1.01
        assert 0.3 < pose.pose[2, 3] < 1.5


def test_a_marker_with_two_poses_is_told(shared):
    image = read_image(shared / "markers" / "test_image_multiple_02.png")
    with pytest.warns(TtusWarning, match="marker 24: a second pose"):
        marker_poses(image, 0.065, "APRILTAG_36H11", TAG_CAMERA)


def test_what_is_refused():
    blank = np.full((480, 640), 128, np.uint8)
    refuses(InputError, "no marker of 4X4_250", board_pose, blank, PHOTO, CAMERA)
    with pytest.raises(InputError, match="no marker of 4X4_50"):
        marker_poses(blank, 0.05, "4X4_50", CAMERA)
    with pytest.raises(InputError, match="dictionary 'QR' is not known"):
        marker_poses(blank, 0.05, "QR", CAMERA)
    refuses(InputError, "millimetres", marker_poses, blank, 65.0, "4X4_50", CAMERA)
    with pytest.raises(InputError, match=r"between 0\.0001 and 2 m, got 1e-300$"):
        marker_poses(blank, 1e-300, "4X4_50", CAMERA)
    refuses(InputError, "millimetres", Board, 3, 4, 25.6, 6.6, "4X4_250")
    refuses(InputError, "0 x 4", Board, 0, 4, 0.02, 0.01, "4X4_250")
    tag = drawn(looking([0.6, 0.1, 0.2], [0.02, -0.01, 0.35]))
    with pytest.raises(InputError, match="markers seen, 7, is on a board of 1 x 2"):
        board_pose(tag, Board(1, 2, 0.06, 0.01, "APRILTAG_36H11"), CAMERA)


def test_a_truncated_photo_is_refused_without_other_words(tmp_path, capfd):
    """OpenCV fills it in, and libpng speaks on stderr."""
    cv2.imwrite(str(tmp_path / "whole.png"), np.full((60, 80), 9, np.uint8))
    content = (tmp_path / "whole.png").read_bytes()
    (tmp_path / "cut.png").write_bytes(content[: len(content) // 2])
    refuses(FileError, "truncated PNG", read_image, tmp_path / "cut.png")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("content", [b"no image", b"\x89PNG\r\n\x1a\n" + bytes(40)])
def test_files_that_are_no_image(tmp_path, content):
    (tmp_path / "photo.png").write_bytes(content)
    with pytest.raises(FileError, match=r"photo\.png is a damaged or truncated PNG"):
        read_image(tmp_path / "photo.png")


def test_the_facts_of_a_pose():
    pose = MarkerPose((1,), np.eye(4), np.diag([1.0, 4, 9, 16, 25, 36]), 0.1)
    assert json.dumps([pose.turn_std.tolist(), pose.shift_std.tolist()]) == (
        "[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]"
    )
