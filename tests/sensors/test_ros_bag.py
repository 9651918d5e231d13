"""Recordings of ROS 1, ROS 2 and MCAP, written here and read again."""

import shutil
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.hostile import mutated
from tests.kit import FileError, MissingPackageError, TtusError, TtusWarning, refuses
from ttus_opt.probe.rigid_motion import homogeneous, inverse
from ttus_opt.sensors.stream_files import raw_recordings, read_poses, read_wrenches

rosbags = pytest.importorskip("rosbags", reason="needs ttus-opt[sensors]")

KINDS = ["ros1", "sqlite3", "mcap"]


def turn(i):
    return Rotation.from_rotvec([0.1 * i, 0.05, -0.2])


def recorded(folder, kind, twice=False):
    """Ten poses, transforms and wrenches, 20 Hz."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    ros1 = kind == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    T = {
        name.split("/")[-1]: known
        for name, known in store.types.items()
        if name.startswith(("geometry_msgs", "builtin", "std_msgs/msg/Header"))
    }
    if ros1:
        path = folder / "r.bag"
        writer = rosbag1.Writer(path)
    else:
        path = folder / kind
        plugin = rosbag2.StoragePlugin[kind.upper()]
        writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)

    def header(i):
        stamp = T["Time"](sec=1_700_000_000, nanosec=50_000_000 * i)
        more = {"seq": i} if ros1 else {}
        return T["Header"](stamp=stamp, frame_id="base", **more)

    def messages(i):
        x, y, z, w = turn(i).as_quat()
        q = T["Quaternion"](x=x, y=y, z=z, w=w)
        v = T["Vector3"](x=0.1 * i, y=2.0, z=3.0)
        pose = T["Pose"](position=T["Point"](x=0.1 * i, y=2.0, z=3.0), orientation=q)
        return {
            "PoseStamped": T["PoseStamped"](header(i), pose),
            "TransformStamped": T["TransformStamped"](
                header(i), "probe", T["Transform"](v, q)
            ),
            "WrenchStamped": T["WrenchStamped"](header(i), T["Wrench"](v, v)),
        }

    with writer:
        open_ = {
            name: writer.add_connection(
                f"/{name.lower()}", f"geometry_msgs/msg/{name}", typestore=store
            )
            for name in messages(0)
        }
        for i in [*range(10), *([4] if twice else [])]:
            for name, message in messages(i).items():
                encode = store.serialize_ros1 if ros1 else store.serialize_cdr
                raw = encode(message, f"geometry_msgs/msg/{name}")
                writer.write(open_[name], 50_000_000 * i, raw)
    return path


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


@pytest.mark.parametrize(
    "n",
    [
        20,
        pytest.param(200, marks=pytest.mark.slow),
        pytest.param(3000, marks=[pytest.mark.slow, pytest.mark.long]),
    ],
)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.filterwarnings("ignore::ttus_opt.core.errors.TtusWarning")
def test_mutations(tmp_path, kind, n):
    bag = recorded(tmp_path, kind)
    suffix = {"sqlite3": "*.db3", "mcap": "*.mcap"}.get(kind)
    sound = bag if suffix is None else next(iter(bag.glob(suffix)))
    content, rng = sound.read_bytes(), np.random.default_rng(7)
    for number in range(n):
        sound.write_bytes(mutated(content, rng))
        try:
            read_wrenches(bag)
        except TtusError as error:
            assert "\n" not in str(error)
        except BaseException as error:
            raise AssertionError(f"mutation {number} of {kind}") from error
        # sqlite leaves files of its own beside a damaged one
        for beside in sound.parent.glob(f"{sound.name}-*"):
            shutil.rmtree(beside, ignore_errors=True)


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
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    ros1 = kind == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if ros1:
        fields = "geometry_msgs/TransformStamped[] transforms"
        store.register(get_types_from_msg(fields, "tf2_msgs/msg/TFMessage"))
    rooms = ("geometry_msgs", "builtin", "std_msgs/msg/Header", "nav_", "tf2_")
    T = {
        name.split("/")[-1]: known
        for name, known in store.types.items()
        if name.startswith(rooms)
    }
    if ros1:
        path = folder / "r.bag"
        writer = rosbag1.Writer(path)
    else:
        path = folder / kind
        writer = rosbag2.Writer(path, version=9)

    def header(t, frame):
        stamp = T["Time"](sec=int(t), nanosec=round(1e9 * (t - int(t))))
        return T["Header"](stamp=stamp, frame_id=frame, **({"seq": 0} if ros1 else {}))

    def parts(motion):
        x, y, z, w = Rotation.from_matrix(motion[:3, :3]).as_quat()
        place = dict(zip("xyz", motion[:3, 3].tolist(), strict=True))
        return place, T["Quaternion"](x=x, y=y, z=z, w=w)

    def transform(t, parent, child, motion):
        place, turn = parts(motion)
        moved = T["Transform"](T["Vector3"](**place), turn)
        return T["TransformStamped"](header(t, parent), child, moved)

    tree, odometry = "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry"
    with writer:
        open_ = {
            topic: writer.add_connection(topic, kind_, typestore=store)
            for topic, kind_ in (
                ("/tf", tree),
                ("/tf_static", tree),
                ("/odom", odometry),
            )
        }

        def write(topic, t, message, kind_):
            encode = store.serialize_ros1 if ros1 else store.serialize_cdr
            writer.write(open_[topic], round(1e9 * t), encode(message, kind_))

        static = T["TFMessage"]([transform(TIME[0], "arm", "probe", FIXED)])
        write("/tf_static", TIME[0], static, tree)
        for i, t in enumerate(TIME):
            sent = [transform(t, "base", "arm", arm(t))]
            if i % 2 == 0:
                sent.append(transform(t, "base", "camera", BACK))
            write("/tf", t, T["TFMessage"](sent), tree)
            place, turn = parts(arm(t))
            zero = T["Vector3"](0.0, 0.0, 0.0)
            pose = T["Pose"](T["Point"](**place), turn)
            still = T["TwistWithCovariance"](T["Twist"](zero, zero), np.zeros(36))
            around = T["PoseWithCovariance"](pose, np.zeros(36))
            odom = T["Odometry"](header(t, "base"), "arm", around, still)
            write("/odom", t, odom, odometry)
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
