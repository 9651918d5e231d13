"""Recordings of ROS 1, ROS 2 and MCAP, written here and read again."""

import shutil
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.hostile import mutated
from tests.refusals import refuses
from ttus_opt.core.errors import FileError, MissingPackageError, TtusError, TtusWarning
from ttus_opt.sensors.stream_files import read_poses, read_wrenches

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
    with pytest.raises(MissingPackageError, match=r"ttus-opt\[sensors\]"):
        read_poses(tmp_path / "r.bag")


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
