"""A robot by messages: alone, and by the OpenIGTLink example against a server."""

import importlib.util
import socket
import time
from pathlib import Path

import numpy as np
import pytest

from tests.kit import InputError, refuses
from ttus_opt.live.driven_patient import DrivenPatient
from ttus_opt.live.safety import State, Supervisor
from ttus_opt.sensors.open_igt_message import MessageReader

EXAMPLE = Path(__file__).parents[2] / "examples" / "openigtlink" / "live_follower.py"
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
AT, WRENCH = np.array([0.01, 0.2, 0.15]), np.array([1.0, -2.0, 3.0, 0.1, 0.2, 0.3])


def test_joins_the_newest_and_passes_the_target_on():
    told = []
    robot = DrivenPatient(lambda *target: told.append(target))
    assert not robot.ready(0.0)
    robot.take_pose(1.0, np.eye(3), np.zeros(3))
    robot.take_pose(1.05, TURN, AT)
    assert not robot.ready(1.05)  # no wrench yet
    robot.take_wrench(1.02, WRENCH)
    sample = robot.sense(1.1, TURN.T, 2.0 * AT)
    assert sample.time == 1.1
    np.testing.assert_array_equal(sample.rotation, TURN)
    np.testing.assert_array_equal(sample.position, AT)
    np.testing.assert_array_equal(sample.wrench, WRENCH)
    np.testing.assert_array_equal(told[0][1], 2.0 * AT)


@pytest.mark.parametrize("silent", ["pose", "wrench"])
def test_silence_of_either_stops(silent):
    robot = DrivenPatient(lambda *_: None)
    for now in (0.0, 0.2):
        if not (silent == "pose" and now):
            robot.take_pose(now, TURN, AT)
        if not (silent == "wrench" and now):
            robot.take_wrench(now, WRENCH)
    assert robot.ready(0.1)
    found, safety = robot.sense(0.2, TURN, AT).wrench, Supervisor(None)
    safety.check_wrench(float(np.linalg.norm(found[:3])), 0.0)
    assert safety.state is State.STOP


@pytest.mark.parametrize(
    "bad", [(2.0 * TURN, AT), (TURN, np.array([0.0, np.nan, 0.0])), (TURN, AT[:2])]
)
def test_refuses_what_is_no_pose(bad):
    robot = DrivenPatient(lambda *_: None)
    robot.take_pose(0.0, TURN, AT)
    refuses(InputError, "", robot.take_pose, 0.1, *bad)
    np.testing.assert_array_equal(robot.here[1], AT)


@pytest.mark.skipif(not EXAMPLE.exists(), reason="no examples here")
def test_the_openigtlink_example():
    pyigtl = pytest.importorskip("pyigtl", reason="needs pyigtl")

    from tests.sensors.test_open_igt_link import SensorMessage

    spec = importlib.util.spec_from_file_location("live_follower", EXAMPLE)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = TURN, 1e3 * AT
    with socket.create_server(("127.0.0.1", 0)) as server:
        robot = example.IgtRobot(*server.getsockname())
        there, _ = server.accept()
        there.settimeout(5.0)
        pose = pyigtl.TransformMessage(matrix, device_name="Probe").pack()
        there.sendall(pose[:50])
        robot.poll()
        assert not robot.patient.ready(time.monotonic())
        there.sendall(pose[50:] + SensorMessage(WRENCH, device_name="Wrench").pack())
        ends = time.monotonic() + 5.0
        while not robot.patient.ready(time.monotonic()):
            robot.poll()
            assert time.monotonic() < ends
            time.sleep(0.001)
        sample = robot.patient.sense(time.monotonic(), TURN.T, 2.0 * AT)
        np.testing.assert_allclose(sample.position, AT, atol=1e-6)
        np.testing.assert_allclose(sample.rotation, TURN, atol=1e-6)
        np.testing.assert_array_equal(sample.wrench, WRENCH)
        reader, heard = MessageReader(), []
        while not heard:
            heard += reader.feed(there.recv(65536))
        assert (heard[0].device, heard[0].fault) == ("ProbeTarget", "")
        np.testing.assert_allclose(heard[0].values[:3, 3], 2e3 * AT, rtol=1e-6)
        np.testing.assert_allclose(heard[0].values[:3, :3], TURN.T, atol=1e-6)
        there.close()
        with pytest.raises(InputError, match="closed"):
            for _ in range(1000):
                robot.poll()
                time.sleep(0.001)
        robot.close()
