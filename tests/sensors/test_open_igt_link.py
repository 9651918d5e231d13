"""OpenIGTLink against a server in this process."""

import contextlib
import itertools
import re
import socket
import struct
import threading
import time
import warnings
from types import SimpleNamespace
from unittest.mock import ANY

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.hostile import SEED, mutated
from tests.kit import InputError, TtusError, TtusWarning, refuses
from ttus_opt.sensors import open_igt_link as igt
from ttus_opt.sensors import open_igt_message
from ttus_opt.sensors.open_igt_message import HEADER, MessageReader, crc64

pyigtl = pytest.importorskip("pyigtl", reason="needs pyigtl, which sends")

TURN = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()


def transform(i, device="ProbeToTracker"):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = TURN, [10.0 * i, 20.0, -30.0]
    return pyigtl.TransformMessage(matrix, timestamp=50.0 + 0.1 * i, device_name=device)


class SensorMessage(pyigtl.messages.MessageBase):
    """Count, status, unit, then ``count`` doubles; pyigtl has none."""

    def __init__(self, values, **more):
        super().__init__(**more)
        self._message_type, self.values = "SENSOR", values
        self._valid_message = True

    def _pack_content(self):
        head = struct.pack(">BBQ", len(self.values), 0, 0)
        return head + self.values.astype(">f8").tobytes()


def sensor(i, n=6):
    values = np.arange(1.0, 7.0)[:n] + i
    return SensorMessage(values, timestamp=60.0 + 0.01 * i, device_name="Force")


class Bytes:
    """A message as it travels."""

    def __init__(self, content):
        self.content = content

    def pack(self):
        return self.content


def at_once(messages):
    """Messages that arrive together, also on a busy machine."""
    return Bytes(b"".join(message.pack() for message in messages))


def bent(i, value=np.nan):
    message = transform(i)
    message.matrix[0, 0] = value
    return message


def flipped(i):
    content = bytearray(transform(i).pack())
    content[HEADER.size + 40] ^= 1
    return Bytes(bytes(content))


@contextlib.contextmanager
def serving(messages, *, closing=False):
    """Sends all of it, with a moment between two; then is silent, or closes."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        done = threading.Event()

        def serve():
            with contextlib.suppress(OSError):
                connection, _ = listener.accept()
                with connection:
                    for message in messages:
                        connection.sendall(message.pack())
                        time.sleep(0.001)
                    done.wait(0.0 if closing else 10.0)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        try:
            yield int(listener.getsockname()[1])
        finally:
            done.set()
            listener.close()
            thread.join(2.0)


def test_poses_and_forces_are_recorded():
    """Every message, in metres, on the sender's clock."""
    sent = [m for i in range(30) for m in (transform(i), sensor(i))]
    with serving([at_once(sent)]) as port:
        found = igt.record("127.0.0.1", port, seconds=0.1)
    poses, wrenches = found.trajectory(), found.wrenches("Force")
    np.testing.assert_allclose(poses.time, 50.0 + 0.1 * np.arange(30), atol=1e-6)
    np.testing.assert_allclose(poses.position[:, 0], 0.01 * np.arange(30), atol=1e-6)
    np.testing.assert_allclose(poses.rotation[7], TURN, atol=1e-6)
    np.testing.assert_allclose(wrenches.force[3], [4, 5, 6])
    np.testing.assert_allclose(wrenches.torque[3], [7, 8, 9])


def test_an_interrupt_ends_a_recording(monkeypatch):
    def interrupt(count):
        if count >= 10:
            raise KeyboardInterrupt

    with serving([transform(i) for i in range(10)]) as port:
        found = igt.record("127.0.0.1", port, progress=interrupt)
    assert len(found.trajectory()) == 10


def test_nobody_listens():
    with socket.socket() as deaf:
        deaf.bind(("127.0.0.1", 0))  # so that nobody else listens there
        told = "no server answers"
        refuses(InputError, told, igt.record, *deaf.getsockname(), patience=0.2)
    with serving([]) as port, pytest.raises(InputError, match="sends nothing"):
        igt.record("127.0.0.1", port, seconds=1.0, patience=0.3)
    refuses(InputError, "65535", igt.record, "127.0.0.1", 0)
    refuses(InputError, "positive", igt.record, "127.0.0.1", 5, seconds=-1.0)


def received(*messages):
    out, reader = igt.Received(), MessageReader()
    for message in reader.feed(b"".join(message.pack() for message in messages)):
        out.take(message)
    return out


def test_what_came_is_checked():
    two = received(transform(0), transform(1, "StylusToTracker"))
    refuses(InputError, r"several devices.*StylusToTracker", two.trajectory)
    refuses(InputError, "sent no poses: one of", two.trajectory, "Needle")
    refuses(InputError, "no forces arrived", two.wrenches)
    text = received(pyigtl.StringMessage("hello", device_name="Text"))
    refuses(InputError, r"no poses arrived, but Text \(STRING\)", text.trajectory)
    assert received(sensor(0, 3), sensor(1, 3)).wrenches().torque is None


def test_the_other_header_is_read():
    """Version 2, as OpenIGTLink 3 sends it: an extended header, and metadata."""
    message = transform(3)
    message.header_version, message.metadata = 2, {"status": "OK", "place": "theatre"}
    pose = received(message, transform(4)).trajectory()
    np.testing.assert_allclose(pose.position[:, 0], [0.03, 0.04], atol=1e-9)
    np.testing.assert_allclose(pose.time, [50.3, 50.4], atol=1e-8)


SHIFTED = transform(0)
SHIFTED.matrix[0, 3] = 2e6

NAN_FORCE = sensor(0)
NAN_FORCE.values[2] = np.nan


@pytest.mark.parametrize(
    ("damaged", "fault"),
    [
        (bent(40), "NaN or infinite"),
        (bent(40, np.inf), "NaN or infinite"),
        (bent(40, 5.0), "no rigid motion"),
        (SHIFTED, "shift beyond a kilometre"),
        (flipped(40), "wrong checksum"),
        (NAN_FORCE, "NaN or infinite"),
        (sensor(40, 4), "neither 3 forces nor 3 forces and 3 torques"),
        (sensor(40, 3), "fewer or more numbers than the first"),
    ],
)
def test_a_damaged_message_is_dropped(damaged, fault):
    """One of them, and a hundred poses and forces besides."""
    sent = [m for i in range(100) for m in (transform(i), sensor(i))]
    sent[81:81] = [damaged]
    told = rf"1 of 201 messages were dropped \(1 {fault}\)"
    with (
        serving([at_once(sent)], closing=True) as port,
        pytest.warns(TtusWarning, match=told),
        pytest.warns(TtusWarning, match="closed the connection after 201"),
    ):
        found = igt.record("127.0.0.1", port)
    assert found.dropped == {fault: 1}
    assert len(found.trajectory()) == 100 and len(found.wrenches().time) == 100


def test_a_body_of_another_size():
    content = bytearray(transform(0).pack()[:-4])
    body = bytes(content[HEADER.size :])
    content[42:58] = struct.pack(">QQ", len(body), crc64(body))
    found = received(Bytes(bytes(content)), transform(1))
    assert found.dropped == {"body of another size": 1}
    assert len(found.trajectory()) == 1


def test_equal_stamps_are_told():
    again = received(transform(1), transform(0), transform(1))
    with pytest.warns(TtusWarning, match="1 of 3 poses of Probe"):
        poses = again.trajectory()
    np.testing.assert_allclose(poses.time, [50.0, 50.1], atol=1e-6)


HALF = Bytes(transform(5).pack()[:70])


@pytest.mark.parametrize(
    ("last", "closing", "told"),
    [
        ([], True, "closed the connection after 5"),
        ([HALF], True, "closed the connection within a message after 5"),
        ([HALF], False, "stopped within a message after 5"),
        ([Bytes(b"\xff" * 58)], False, "not an OpenIGTLink message .* after 5"),
    ],
)
def test_a_server_that_ends_is_noticed(last, closing, told, capfd, monkeypatch):
    """Within 2 s; what came before is kept, and one line says what happened."""
    assert igt.SILENCE + igt.PAUSE <= 2.0
    monkeypatch.setattr(igt, "SILENCE", 0.2)
    sent = at_once([*(transform(i) for i in range(5)), *last])
    with (
        serving([sent], closing=closing) as port,
        pytest.warns(TtusWarning) as warned,  # of silence too on a busy machine
    ):
        found = igt.record("127.0.0.1", port, seconds=30.0)
    assert len(found.trajectory()) == 5
    line = str(warned.list[-1].message)
    assert re.search(told, line) and "\n" not in line
    assert capfd.readouterr() == ("", "")


def test_a_first_message_that_is_none():
    for sent, told in ((Bytes(b"\xff" * 58), "not an OpenIGTLink"), (HALF, "within")):
        with (
            serving([sent], closing=True) as port,
            pytest.raises(InputError, match=f"{told}.*another server or port"),
        ):
            igt.record("127.0.0.1", port, seconds=30.0)


@pytest.mark.parametrize(
    ("at", "damage"),
    [(0, b"\0\7"), (2, b"TRANS-FORM"), (2, b"\0"), (42, b"\0\0\1"), (44, b"\0\0\x11")],
)
def test_a_header_that_is_none(at, damage):
    """At once: a body of gigabytes is not waited for."""
    content = bytearray(transform(0).pack())
    content[at : at + len(damage)] = damage
    refuses(InputError, "a header that is none", received, Bytes(bytes(content)))


def test_silence_is_told_and_outlasted(monkeypatch):
    """A tracker may say nothing of a probe it does not see."""
    monkeypatch.setattr(igt, "SILENCE", 0.2)
    own, told = igt.warn, threading.Event()

    def warn(*words):
        told.set()
        own(*words)

    class Late(Bytes):
        def pack(self):
            assert told.wait(20.0)
            return self.content

    monkeypatch.setattr(igt, "warn", warn)
    late = Late(at_once([transform(1), transform(2)]).content)
    with (
        serving([transform(0), late], closing=True) as port,
        pytest.warns(TtusWarning) as warned,
    ):
        found = igt.record("127.0.0.1", port, seconds=30.0)
    assert len(found.trajectory()) == 3
    first, *_, last = (str(one.message) for one in warned)
    assert "nothing came for 0.2 s after 1 messages" in first
    assert "closed the connection after 3" in last


def test_a_recording_is_bounded(monkeypatch):
    monkeypatch.setattr(igt, "MOST_MESSAGES", 20)
    with serving([transform(i) for i in range(2000)]) as port:
        found = igt.record("127.0.0.1", port)
    assert 20 < found.count < 2000


def test_what_came_is_kept_while_recording(monkeypatch):
    """Every 5 s, here of a clock that goes on by half a second when it is read."""
    clock, counts = SimpleNamespace(monotonic=itertools.count(0.0, 0.5).__next__), []
    monkeypatch.setattr(igt, "SILENCE", np.inf)
    monkeypatch.setattr(igt, "time", clock)
    long = {"seconds": 12.0, "patience": 1e3}
    with serving([at_once([transform(0), transform(1)])]) as port:
        igt.record("127.0.0.1", port, **long, keep=lambda got: counts.append(got.count))
    assert counts == [2, 2]


@pytest.mark.parametrize("n", [60, pytest.param(3000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", ["pose", "force"])
@pytest.mark.parametrize("sealed", [True, False])
def test_mutations(kind, sealed, n, monkeypatch):
    """Damaged messages: our errors and no other, even where the checksum is right."""
    if not sealed:
        monkeypatch.setattr(open_igt_message, "crc64", lambda _: ANY)
    sent = [transform(i) if kind == "pose" else sensor(i) for i in range(3)]
    content = b"".join(message.pack() for message in sent)
    rng = np.random.default_rng(SEED)
    taken = dropped = 0
    for _ in range(n):
        found, reader = igt.Received(), MessageReader()
        with contextlib.suppress(InputError):
            for message in reader.feed(mutated(content, rng)):
                found.take(message)
        taken += found.count
        dropped += found.dropped.total()
        for read in (found.trajectory, found.wrenches):
            with warnings.catch_warnings(action="ignore"):
                try:
                    read()
                except TtusError as error:
                    assert "\n" not in str(error)
    assert taken > n / 4 and (dropped > n / 10 or not sealed)


class Packed(pyigtl.messages.MessageBase):
    """A body by its bytes, after the protocol's tables; pyigtl has no such message."""

    def __init__(self, kind, body, device):
        super().__init__(timestamp=7.0, device_name=device)
        self._message_type, self.body, self._valid_message = kind, body, True

    def _pack_content(self):
        return self.body


def test_positions_tools_and_arrays():
    """POSITION with a whole and a short quaternion, TDATA by tool, NDARRAY."""
    quaternion = Rotation.from_matrix(TURN).as_quat()
    whole = struct.pack(">7f", 10, 20, 30, *quaternion)
    short = struct.pack(">6f", 10, 20, 30, *quaternion[:3])
    columns = np.c_[TURN, [1.0, 2.0, 3.0]].T.ravel()
    tools = b"".join(
        struct.pack(">20sBB12f", name, 2, 0, *columns) for name in (b"Probe", b"Pen")
    )
    forces = np.arange(6.0)
    array = struct.pack(">BBH", 11, 1, 6) + forces.astype(">f8").tobytes()
    rows = struct.pack(">BBHH", 10, 2, 1, 3) + forces[:3].astype(">f4").tobytes()
    found = received(
        Packed("POSITION", whole, "A"),
        Packed("POSITION", short, "B"),
        Packed("TDATA", tools, "Tracker"),
        Packed("NDARRAY", array, "Force"),
        Packed("NDARRAY", rows, "Three"),
    )
    assert not found.dropped
    for name, shift in (("A", [0.01, 0.02, 0.03]), ("B", [0.01, 0.02, 0.03])):
        poses = found.trajectory(name)
        np.testing.assert_allclose(poses.rotation[0], TURN, atol=1e-6)
        np.testing.assert_allclose(poses.position[0], shift, atol=1e-8)
    for name in ("Probe", "Pen"):
        poses = found.trajectory(name)
        np.testing.assert_allclose(poses.rotation[0], TURN, atol=1e-6)
        np.testing.assert_allclose(poses.position[0], [0.001, 0.002, 0.003], atol=1e-9)
    np.testing.assert_array_equal(found.readings["Force"][0][1], forces)
    np.testing.assert_array_equal(found.readings["Three"][0][1], forces[:3])


@pytest.mark.parametrize(
    ("kind", "body", "fault"),
    [
        ("POSITION", struct.pack(">3f", 1, 2, 3), "a position without orientation"),
        ("POSITION", struct.pack(">7f", *[1] * 7), "no rigid motion"),
        ("TDATA", bytes(69), "body of another size"),
        ("TDATA", bytes(70), "no rigid motion"),
        ("NDARRAY", struct.pack(">BBH", 11, 1, 4) + bytes(32), "neither 3 forces"),
        ("NDARRAY", struct.pack(">BBH", 13, 1, 3) + bytes(48), "an unknown type"),
        ("NDARRAY", struct.pack(">BBH", 11, 1, 3) + bytes(16), "another size"),
    ],
)
def test_bodies_that_are_none(kind, body, fault):
    found = received(Packed(kind, body, "A"))
    (told,) = found.dropped
    assert fault in told
