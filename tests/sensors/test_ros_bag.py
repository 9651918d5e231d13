"""Recordings of ROS 1, ROS 2 and MCAP, written here and read again."""

import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.kit import FileError, MissingPackageError, TtusWarning, refuses
from tests.sensors.bags import Bag
from ttus_opt.probe.rigid_motion import homogeneous, inverse
from ttus_opt.sensors.stream_files import raw_recordings, read_poses, read_wrenches

rosbags = pytest.importorskip("rosbags", reason="needs ttus-opt[sensors]")

KINDS = ["ros1", "sqlite3", "mcap"]


def turn(i):
    return Rotation.from_rotvec([0.1 * i, 0.05, -0.2])


def recorded(folder, kind, twice=False):
    """Ten poses, transforms and wrenches, 20 Hz."""
    path = folder / ("r.bag" if kind == "ros1" else kind)
    with Bag(path, kind) as bag:
        for i in [*range(10), *([4] if twice else [])]:
            late = 50_000_000 * i
            header = bag.header(1_700_000_000 * 10**9 + late)
            place, q = (0.1 * i, 2.0, 3.0), bag.Quaternion(*turn(i).as_quat())
            v, pose = bag.Vector3(*place), bag.Pose(bag.Point(*place), q)
            moved = bag.TransformStamped(header, "probe", bag.Transform(v, q))
            bag.write("/posestamped", late, bag.PoseStamped(header, pose))
            bag.write("/transformstamped", late, moved)
            wrench = bag.WrenchStamped(header, bag.Wrench(v, v))
            bag.write("/wrenchstamped", late, wrench)
    return path


def recordings(folder):
    """The file of each kind, which is read without what lies beside it, too."""
    bags = [recorded(folder, kind) for kind in KINDS]
    files = (
        bag if bag.is_file() else [*bag.glob("*.db3"), *bag.glob("*.mcap")][0]
        for bag in bags
    )
    return [*files]


@pytest.mark.parametrize("kind", KINDS)
def test_poses_and_wrenches(tmp_path, kind):
    bag = recorded(tmp_path, kind)
    for topic in ("/posestamped", "/transformstamped"):
        poses = read_poses(bag, topic)
        np.testing.assert_allclose(poses.time - 1.7e9, 0.05 * np.arange(10), atol=1e-6)
        np.testing.assert_allclose(poses.position[:, 0], 0.1 * np.arange(10))
        np.testing.assert_allclose(poses.rotation[7], turn(7).as_matrix(), atol=1e-12)
    wrenches = read_wrenches(bag)
    np.testing.assert_allclose(wrenches.force[3], [0.3, 2, 3])
    np.testing.assert_allclose(wrenches.torque[3], [0.3, 2, 3])


def test_a_single_mcap_file(tmp_path):
    (file,) = recorded(tmp_path, "mcap").glob("*.mcap")
    assert len(read_wrenches(file).time) == 10


def test_a_suffix_in_capitals(tmp_path):
    file = recorded(tmp_path, "ros1").rename(tmp_path / "R.BAG")
    assert len(read_wrenches(file).time) == 10


def test_a_stamp_that_comes_twice_is_told(tmp_path):
    bag = recorded(tmp_path, "ros1", twice=True)
    with pytest.warns(TtusWarning, match="1 messages repeat a time stamp"):
        assert len(read_wrenches(bag).time) == 10


def test_what_is_refused(tmp_path):
    bag = recorded(tmp_path, "ros1")
    refuses(FileError, r"several topics.*/posestamped", read_poses, bag)
    with pytest.raises(FileError, match=r"no topic /other.*one of /wrenchstamped"):
        read_wrenches(bag, "/other")
    refuses(FileError, "not found", read_poses, tmp_path / "no.bag")
    for name in ("text.bag", "text.mcap"):
        (tmp_path / name).write_text("no recording")
        with pytest.raises(FileError, match="cannot be read as a ROS recording"):
            read_poses(tmp_path / name)


def test_without_rosbags_the_extra_is_named(tmp_path, monkeypatch):
    (tmp_path / "r.bag").write_text("no recording")
    for name in [name for name in sys.modules if name.startswith("rosbags")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rosbags", None)
    refuses(MissingPackageError, r"ttus-opt\[sensors\]", read_poses, tmp_path / "r.bag")


TIME = 1.7e9 + 0.05 * np.arange(20)
FIXED = homogeneous(Rotation.from_rotvec([0.2, 0, 1]).as_matrix(), [0.0, 0.0, 0.1])
BACK = homogeneous(Rotation.from_rotvec([0, 0.4, 0]).as_matrix(), [1.0, 0.0, 0.0])


def arm(t):
    """The tool in the base, steady motion and turn."""
    s = t - TIME[0]
    return homogeneous(
        Rotation.from_rotvec([0, 0, 0.5 * s]).as_matrix(), [0.1 * s, 0, 1]
    )


def recorded_frames(folder, kind):
    """base → arm → probe (static), and base → camera (moving at half the rate)."""
    path = folder / ("r.bag" if kind == "ros1" else kind)
    with Bag(path, kind) as bag:

        def parts(motion):
            turned = Rotation.from_matrix(motion[:3, :3]).as_quat()
            return motion[:3, 3].tolist(), bag.Quaternion(*turned)

        def transform(time, parent, child, motion):
            place, q = parts(motion)
            moved = bag.Transform(bag.Vector3(*place), q)
            return bag.TransformStamped(bag.header(time, parent), child, moved)

        zero = bag.Vector3(0.0, 0.0, 0.0)
        still = bag.TwistWithCovariance(bag.Twist(zero, zero), np.zeros(36))
        begin = round(1e9 * TIME[0])
        static = bag.TFMessage([transform(begin, "arm", "probe", FIXED)])
        bag.write("/tf_static", begin, static)
        for i, t in enumerate(TIME):
            time = round(1e9 * t)
            sent = [transform(time, "base", "arm", arm(t))]
            if i % 2 == 0:
                sent.append(transform(time, "base", "camera", BACK))
            bag.write("/tf", time, bag.TFMessage(sent))
            place, q = parts(arm(t))
            pose = bag.Pose(bag.Point(*place), q)
            around = bag.PoseWithCovariance(pose, np.zeros(36))
            odometry = bag.Odometry(bag.header(time), "arm", around, still)
            bag.write("/odom", time, odometry)
    return path


@pytest.mark.parametrize("kind", ["ros1", "sqlite3"])
def test_one_frame_in_another(tmp_path, kind):
    """Through a static link, and upwards through one that moves."""
    bag = recorded_frames(tmp_path, kind)
    found = read_poses(bag, "base:probe")
    expected = np.array([arm(t) @ FIXED for t in TIME])
    np.testing.assert_allclose(found.time, TIME, atol=1e-6)
    np.testing.assert_allclose(found.position, expected[:, :3, 3], atol=1e-9)
    np.testing.assert_allclose(found.rotation, expected[:, :3, :3], atol=1e-9)
    found = read_poses(bag, "camera:probe")
    inside = np.array([inverse(BACK) @ arm(t) @ FIXED for t in found.time])
    assert len(found) == 19  # the camera's last stamp is one before the arm's
    np.testing.assert_allclose(found.position, inside[:, :3, 3], atol=1e-6)
    np.testing.assert_allclose(found.rotation, inside[:, :3, :3], atol=1e-6)
    with pytest.raises(FileError, match="the frames are arm, base, camera, probe"):
        read_poses(bag, "base:needle")


def test_a_topic_is_meant_before_a_frame(tmp_path):
    bag = recorded_frames(tmp_path, "ros1")
    found = read_poses(bag)  # Odometry, although /tf has two
    np.testing.assert_allclose(found.position, [arm(t)[:3, 3] for t in TIME])
    names = [raw.name for raw in raw_recordings(bag)]
    assert names == ["/odom", "base:arm", "base:camera"]


def test_a_database_without_metadata(tmp_path):
    bag = recorded_frames(tmp_path, "sqlite3")
    (file,) = bag.glob("*.db3")
    alone = tmp_path / "alone.db3"
    alone.write_bytes(file.read_bytes())
    np.testing.assert_array_equal(
        read_poses(alone, "/odom").position, read_poses(bag, "/odom").position
    )
    alone.write_bytes(file.read_bytes()[:3000])
    refuses(FileError, "cannot be read as a ROS recording", read_poses, alone)
