"""The ROS 2 package's loop, without ROS; its node, with stand-ins for what ROS has."""

import ast
import importlib
import sys
import types
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.kit import (
    InputError,
    TtusError,
    deepest_pose,
    pressing,
    refuses,
    scaled,
    small_scene,
)
from ttus_opt.haptic.renderer import Renderer
from ttus_opt.probe.point_shell import PointShell

FOLDER = Path(__file__).parents[2] / "examples" / "ros2"
PROBE = "ellipsoid:0.02,0.015,0.015"

pytestmark = pytest.mark.skipif(not FOLDER.exists(), reason="no examples/ros2 here")


@pytest.fixture
def package(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)
    yield importlib.import_module("ttus_wrench.wrench_loop")
    for name in [n for n in sys.modules if n.startswith("ttus_wrench")]:
        del sys.modules[name]


@pytest.fixture
def files(tmp_path):
    """A field, one twice as stiff, one on another grid."""
    field = pressing(small_scene("trilinear"))
    field.save(tmp_path / "field.nc")
    scaled(field, 2.0).save(tmp_path / "stiff.nc")
    pressing(small_scene("trilinear", (9, 20, 12))).save(tmp_path / "other.nc")
    return tmp_path


@pytest.fixture
def pose():
    R, at = deepest_pose(small_scene("trilinear"))
    return at, Rotation.from_matrix(R).as_quat()


@pytest.mark.slow
def test_the_newest_pose_then_silence(package, files, pose):
    """Its wrench is the renderer's; without new poses it fades, 0.1 s to 0.2 s."""
    settings = package.Settings(str(files / "field.nc"), PROBE)
    loop = package.WrenchLoop(settings)
    assert loop.tick(0.0) is None
    loop.take("patient", 100.0, (0.0, 0.0, 7.0), (0.0, 0.0, 0.0, 1.0), 5.0)
    assert not loop.tick(5.0).any()
    loop.take("patient", 100.1, *pose, 5.0)
    alone = Renderer(pressing(small_scene("trilinear")), PointShell.from_spec(PROBE))
    found = alone.render(Rotation.from_quat(pose[1]), pose[0])
    expected = np.concatenate([found.force, found.torque])
    assert np.linalg.norm(found.force) > 0.1
    for now, share in ((5.0, 1.0), (5.1, 1.0), (5.15, 0.5), (5.25, 0.0), (5.05, 1.0)):
        np.testing.assert_allclose(loop.tick(now), share * expected, atol=1e-9)


def test_poses_that_are_refused(package, files, pose):
    """What is refused leaves the last pose and its wrench."""
    loop = package.WrenchLoop(package.Settings(str(files / "field.nc"), PROBE))
    loop.take("patient", 1.0, *pose, 0.0)
    before = loop.tick(0.0).copy()
    at, quaternion = pose
    for bad, error in (
        (("map", 2.0, at, quaternion), "transform it to 'patient'"),
        (("patient", 0.5, at, quaternion), "clock was set back"),
        (("patient", 2.0, at, 2.0 * quaternion), "quaternion"),
        (("patient", 2.0, at, np.full(4, np.nan)), "quaternion"),
        (("patient", 2.0, (0.0, np.nan, 0.0), quaternion), "not finite"),
    ):
        refuses(InputError, error, loop.take, *bad, 0.0)
        np.testing.assert_array_equal(loop.tick(0.0), before)


def test_a_swap_blends_in(package, files, pose):
    settings = package.Settings(str(files / "field.nc"), PROBE, force_limit=40.0)
    loop = package.WrenchLoop(settings)
    loop.take("patient", 1.0, *pose, 0.0)
    before = loop.tick(0.0).copy()
    for name in ("other.nc", "none.nc"):
        refuses(TtusError, "", loop.swap, str(files / name))
    np.testing.assert_array_equal(loop.tick(0.0), before)
    loop.swap(str(files / "stiff.nc"))
    assert np.linalg.norm(loop.tick(0.0) - before) < 0.1 * np.linalg.norm(before)
    for step in range(800):  # moving in and out of contact settles it
        far = step % 2
        loop.take("patient", 2.0 + step, pose[0] * (1.0 + 2.0 * far), pose[1], 0.0)
        wrench = loop.tick(0.0)
    loop.take("patient", 9000.0, *pose, 0.0)
    wrench = loop.tick(0.0)
    np.testing.assert_allclose(wrench, 2.0 * before, rtol=1e-6)


@pytest.mark.parametrize(
    "wrong", [{"probe": ""}, {"field_file": ""}, {"rate": 0.0}, {"timeout": np.nan}]
)
def test_settings_are_checked(package, wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        package.Settings(**{"field_file": "field.nc", "probe": PROBE} | wrong)


class Message(SimpleNamespace):
    """Any ROS message: what is asked for is there."""

    def __getattr__(self, name):
        setattr(self, name, Message())
        return getattr(self, name)


class Node:
    """What the node uses of rclpy's, with parameters of the test."""

    given: dict[str, object] = {}  # noqa: RUF012

    def __init__(self, name):
        self.sent, self.calls, self.parameters = [], {}, dict(self.given)

    def declare_parameter(self, name, default):
        self.parameters.setdefault(name, default)
        return self.get_parameter(name)

    def get_parameter(self, name):
        return SimpleNamespace(value=self.parameters[name])

    def create_publisher(self, kind, topic, depth):
        return SimpleNamespace(publish=self.sent.append)

    def create_subscription(self, kind, topic, call, depth, callback_group=None):
        self.calls[topic] = call

    def create_timer(self, period, call, callback_group=None):
        self.calls[period] = call

    def create_service(self, kind, name, call, callback_group):
        self.calls[name] = call

    def get_clock(self):
        return Message(now=lambda: Message(to_msg=lambda: "now"))

    def get_logger(self):
        return SimpleNamespace(warning=lambda text, **_: self.sent.append(text))


@pytest.fixture
def node(package, monkeypatch):
    group = {"MutuallyExclusiveCallbackGroup": object}
    for name, has in {
        "rclpy": {},
        "rclpy.callback_groups": group,
        "rclpy.executors": {"MultiThreadedExecutor": object},
        "rclpy.node": {"Node": Node},
        "geometry_msgs": {},
        "geometry_msgs.msg": {"PoseStamped": Message, "WrenchStamped": Message},
        "std_srvs": {},
        "std_srvs.srv": {"Trigger": SimpleNamespace(Request=Message, Response=Message)},
    }.items():
        module = types.ModuleType(name)
        vars(module).update(has)
        monkeypatch.setitem(sys.modules, name, module)
    return importlib.import_module("ttus_wrench.wrench_node").WrenchNode


def test_the_node(node, files, pose, monkeypatch):
    given = {"field_file": str(files / "field.nc"), "probe": PROBE, "rate": 250.0}
    monkeypatch.setattr(Node, "given", given)
    started = node()
    take, tick, swap = (started.calls[n] for n in ("probe_pose", 0.004, "~/swap"))
    tick()
    assert started.sent == []  # nothing before the first pose
    message = Message()
    message.header.frame_id = "patient"
    message.header.stamp = Message(sec=3, nanosec=5)
    (at, quaternion) = pose
    message.pose.position = Message(**dict(zip("xyz", at, strict=True)))
    message.pose.orientation = Message(**dict(zip("xyzw", quaternion, strict=True)))
    take(message)
    tick()
    expected = started.loop.tick(0.0)
    (answer,) = started.sent
    assert (answer.header.frame_id, answer.header.stamp) == ("patient", "now")
    parts = (answer.wrench.force, answer.wrench.torque)
    sent = [getattr(part, axis) for part in parts for axis in "xyz"]
    np.testing.assert_array_equal(sent, expected)
    message.header.frame_id = "map"
    take(message)
    assert "transform it" in started.sent[-1]
    for name, success in (("other.nc", False), ("stiff.nc", True)):
        started.parameters["field_file"] = str(files / name)
        assert swap(Message(), Message()).success is success


def test_the_follower_node(node, files, tmp_path, monkeypatch):
    """Pose and wrench become the follower's sample; its target goes to the robot."""
    pytest.importorskip("msgspec", reason="needs ttus-opt[live]")
    from ttus_opt import example
    from ttus_opt.live.safety import State
    from ttus_opt.live.sealing import write_key

    write_key(tmp_path / "key")
    given = {"key": str(tmp_path / "key"), "host": "127.0.0.1", "port": 0}
    given["surface_file"] = str(example.path("surface.nc"))
    monkeypatch.setattr(Node, "given", given)
    started = importlib.import_module("ttus_wrench.follower_node").FollowerNode()
    names = "robot_pose", "robot_wrench", 0.01
    pose, wrench, tick = (started.calls[name] for name in names)
    tick()
    assert started.sent == []  # nothing is known of the robot
    message = Message()
    message.header.frame_id = "patient"
    at, quaternion = (0.0, 0.2, 0.15), (0.0, 0.0, 0.6, 0.8)
    message.pose.position = Message(**dict(zip("xyz", at, strict=True)))
    message.pose.orientation = Message(**dict(zip("xyzw", quaternion, strict=True)))
    force = Message()
    for part in (force.wrench.force, force.wrench.torque):
        part.x, part.y, part.z = 0.01, 0.02, 0.03
    pose(message)
    wrench(force)
    tick()
    (target,) = started.sent
    p, q = target.pose.position, target.pose.orientation
    np.testing.assert_allclose([p.x, p.y, p.z], at, atol=1e-12)
    np.testing.assert_allclose([q.x, q.y, q.z, q.w], quaternion, atol=1e-12)
    assert started.side.peer.safety.state is State.HOLD  # no operator yet
    message.header.frame_id = "map"
    pose(message)
    assert "map" in started.sent[-1]
    monkeypatch.setattr("ttus_opt.live.driven_patient.SILENCE", -1.0)  # as if long ago
    tick()
    assert started.side.peer.safety.state is State.STOP
    started.link.close()


def test_the_names_agree():
    """package.xml, setup.py, resource and module, as colcon looks for them."""
    name = ElementTree.parse(FOLDER / "package.xml").findtext("name")
    assert (FOLDER / "resource" / name).is_file()
    (call,) = (
        found
        for found in ast.walk(ast.parse((FOLDER / "setup.py").read_text()))
        if isinstance(found, ast.Call)
    )
    assert call.func.id == "setup"
    settings = (FOLDER / "setup.py").read_text()
    assert f'NAME = "{name}"' in settings
    assert f"lib/{name}" in (FOLDER / "setup.cfg").read_text()
    for script in ("wrench_node", "follower_node"):
        assert f"{{NAME}}.{script}:main" in settings
        node = ast.parse((FOLDER / name / f"{script}.py").read_text())
        assert "main" in [f.name for f in node.body if isinstance(f, ast.FunctionDef)]
