"""Scans put together: by their poses, refined, and refused."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.kit import FileError, InputError, MissingPackageError, refuses
from tests.sensors.cameras import Camera, measured, see_ellipsoid, see_plane
from tests.sensors.test_stream_formats import SAMPLES
from ttus_opt.sensors.depth import DepthImage
from ttus_opt.sensors.depth_noise import TimeOfFlight
from ttus_opt.sensors.intrinsics import Intrinsics
from ttus_opt.sensors.stitching import PoseUncertainty, read_camera_poses, stitch
from ttus_opt.sensors.stream_files import read_poses
from ttus_opt.sensors.unprojection import Unprojection

CAMERAS = (
    Camera((-0.35, 0.8, 0.0), (0.0, 0.1, 0.0)),
    Camera((0.35, 0.8, 0.1), (0.0, 0.1, 0.0)),
)
POSES = np.stack([camera.pose for camera in CAMERAS])
CENTRE, SEMI_AXES = np.array([0, 0.11, 0]), np.array([0.17, 0.11, 0.35])
UP = np.array([0.0, 1.0, 0.0])


def image(camera, what, seed=0):
    z = see_plane(camera, UP, 0.0)
    if what == "body and bed":
        z = np.minimum(z, see_ellipsoid(camera, CENTRE, SEMI_AXES))
    if what == "cylinder":
        z = see_ellipsoid(camera, CENTRE, np.array([0.15, 0.15, 1e3]))
    rng = np.random.default_rng(seed)
    depth = measured(np.where(z < 2, z, np.nan), 0.001, 0.1, rng)
    own = Intrinsics(camera.matrix, np.zeros(0))
    return DepthImage(depth, Unprojection.from_intrinsics(own, camera.shape))


@cache
def images(what):
    return [image(camera, what, k) for k, camera in enumerate(CAMERAS)]


def moved(pose, shift, turn):
    """About the camera, in mm and degrees."""
    change = np.eye(4)
    change[:3, :3] = Rotation.from_rotvec(np.deg2rad(turn)).as_matrix()
    change[:3, 3] = 1e-3 * np.array(shift)
    return pose @ change


OFF = moved(POSES[1], (6.0, -4.0, 5.0), (0.4, -0.3, 0.5))


def body_error(pose):
    """How far the second scan's points are from where they belong [m]."""
    points = images("body and bed")[1].to_cloud().points
    truth, found = (points @ p[:3, :3].T + p[:3, 3] for p in (POSES[1], pose))
    return float(np.linalg.norm(found - truth, axis=1).mean())


def test_by_measured_poses():
    found = stitch(images("body and bed"), POSES, noise=TimeOfFlight(0.001))
    parts = [
        shot.to_cloud(pose, noise=TimeOfFlight(0.001))
        for shot, pose in zip(images("body and bed"), POSES, strict=True)
    ]
    np.testing.assert_allclose(
        found.cloud.points, np.concatenate([part.points for part in parts]), atol=1e-12
    )
    assert found.cloud.std.shape == (len(found.cloud.points),)
    assert found.cloud.dropped == tuple(part.dropped[0] for part in parts)
    assert found.refinements == ()
    np.testing.assert_allclose(found.poses, POSES)


def test_a_pose_that_is_off_is_refined():
    pytest.importorskip("small_gicp", reason="needs ttus-opt[sensors]")
    poses = np.stack([POSES[0], OFF])
    assert body_error(OFF) > 5e-3
    found = stitch(images("body and bed"), poses, refine=PoseUncertainty())
    assert body_error(found.poses[1]) < 1.5e-3
    np.testing.assert_array_equal(found.poses[0], POSES[0])
    (refinement,) = found.refinements
    assert refinement.scan == 1
    assert refinement.residual < 1.4e-3 < refinement.residual_before
    assert refinement.shift == pytest.approx(9e-3, abs=4e-3)
    assert 0.3 < refinement.overlap < 1.0


@pytest.mark.slow
def test_a_surely_measured_pose_stays():
    """The measured pose is a prior: the surer it is, the less it is moved."""
    pytest.importorskip("small_gicp", reason="needs ttus-opt[sensors]")
    slightly = moved(POSES[1], (0.0, 0.5, 0.0), (0.0, 0.0, 0.05))
    poses = np.stack([POSES[0], slightly])
    steps = []
    for shift, turn in ((0.005, 0.5), (0.0005, 0.05)):
        uncertainty = PoseUncertainty(shift, float(np.deg2rad(turn)))
        steps.append(
            stitch(images("body and bed"), poses, refine=uncertainty).refinements[0]
        )
    assert steps[0].turn > 1.02 * steps[1].turn
    assert steps[0].shift > 1.02 * steps[1].shift


AWAY = POSES[1] + np.pad([[0.0], [0.3], [0.0]], ((0, 1), (3, 0)))


@pytest.mark.parametrize(
    ("what", "second", "uncertainty", "told"),
    [
        ("bed", POSES[1], (), "scan 2 slides on the others"),
        ("cylinder", POSES[1], (), "scan 2 slides on the others"),
        ("body and bed", OFF, (0.0005, 0.001), "deviations of its measured pose"),
        ("body and bed", AWAY, (0.1,), "scan 2 overlaps the others by 0 %"),
    ],
)
def test_what_cannot_be_refined_is_refused(what, second, uncertainty, told):
    pytest.importorskip("small_gicp", reason="needs ttus-opt[sensors]")
    poses, refine = np.stack([POSES[0], second]), PoseUncertainty(*uncertainty)
    refuses(InputError, told, stitch, images(what), poses, refine=refine)


def test_refusals(monkeypatch):
    shots = images("body and bed")
    refuses(InputError, "2 images have 1 poses", stitch, shots, POSES[:1])
    refuses(InputError, "0 images", stitch, [], [])
    with pytest.raises(InputError, match="more than one scan"):
        stitch(shots[:1], POSES[:1], refine=PoseUncertainty())
    with pytest.raises(InputError, match="millimetres"):
        stitch(shots[:1], [np.array(POSES[0]) + 1e3 * np.eye(4, k=3)])
    for shift, turn in ((0.0, 0.1), (5.0, 0.01), (0.005, 1.0), (np.nan, 0.1)):
        refuses(InputError, "another unit", PoseUncertainty, shift, turn)
    monkeypatch.setitem(__import__("sys").modules, "small_gicp", None)
    with pytest.raises(MissingPackageError, match=r"ttus-opt\[sensors\]"):
        stitch(shots, POSES, refine=PoseUncertainty())


def poses_file(file, order="wxyz"):
    lines = ["t,px,py,pz,qw,qx,qy,qz"]
    for k, pose in enumerate(POSES):
        turn = Rotation.from_matrix(pose[:3, :3])
        q = turn.as_quat(scalar_first=order == "wxyz")
        lines.append(",".join(f"{v:.9f}" for v in [k, *pose[:3, 3], *q]))
    file.write_text("\n".join(lines) + "\n")
    return file


def test_poses_of_a_file(tmp_path):
    for order in ("wxyz", "xyzw"):
        file = poses_file(tmp_path / "poses.csv", order)
        found = read_camera_poses(file, 2, order=order)
        np.testing.assert_allclose(found, POSES, atol=1e-8)
    refuses(FileError, "has 2 poses for 3 images", read_camera_poses, file, 3)
    refuses(FileError, "has 2 poses for 1 image:", read_camera_poses, file, 1)


def test_poses_of_a_tracker(tmp_path):
    file = SAMPLES["press.trc"](tmp_path / "press.trc")
    found = read_camera_poses(file, 6)
    np.testing.assert_allclose(found[:, :3, 3], read_poses(file).position)


def test_where_a_body_was_seen_from():
    """The middle of cameras on one side; nowhere when they stand around."""
    both = stitch([image(c, "body and bed") for c in CAMERAS], POSES)
    np.testing.assert_allclose(both.seen_from, [0.0, 0.8, 0.05])
    opposite = Camera((0.0, -0.8, 0.1), (0.0, 0.1, 0.0))
    around = [CAMERAS[0], CAMERAS[1], opposite]
    poses = np.stack([camera.pose for camera in around])
    assert stitch([image(CAMERAS[0], "body and bed")] * 3, poses).seen_from is None
