"""OpenIGTLink against a server in this process."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.hostile import SEED, mutated
from ttus_opt.errors import InputError, TtusError, TtusWarning
from ttus_opt.sensors import open_igt_link as igt

pyigtl = pytest.importorskip("pyigtl", reason="needs ttus-opt[live]")

KINDS = {
    "TRANSFORM": pyigtl.TransformMessage,
    "SENSOR": igt.sensor_message(pyigtl),
    "STRING": pyigtl.StringMessage,
}

TURN = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()


def transform(i: int, device: str = "ProbeToTracker") -> Any:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = TURN, [10.0 * i, 20.0, -30.0]
    return pyigtl.TransformMessage(matrix, timestamp=50.0 + 0.1 * i, device_name=device)


def sensor(i: int, n: int = 6) -> Any:
    kind = igt.sensor_message(pyigtl)
    values = np.arange(1.0, 7.0)[:n] + i
    return kind(values, timestamp=60.0 + 0.01 * i, device_name="Force")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def serving(messages: list[Any]) -> Iterator[int]:
    """Sends all of it, with a moment between two, to whoever connects."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        done = threading.Event()

        def serve() -> None:
            with contextlib.suppress(OSError):
                connection, _ = listener.accept()
                with connection:
                    for message in messages:
                        connection.sendall(message.pack())
                        time.sleep(0.001)
                    done.wait(10.0)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        try:
            yield int(listener.getsockname()[1])
        finally:
            done.set()
            listener.close()
            thread.join(2.0)


def test_poses_and_forces_are_recorded() -> None:
    """Every message, in metres, on the sender's clock."""
    sent = [m for i in range(30) for m in (transform(i), sensor(i))]
    with serving(sent) as port:
        found = igt.record("127.0.0.1", port, seconds=0.6)
    poses, wrenches = found.trajectory(), found.wrenches("Force")
    np.testing.assert_allclose(poses.time, 50.0 + 0.1 * np.arange(30), atol=1e-6)
    np.testing.assert_allclose(poses.position[:, 0], 0.01 * np.arange(30), atol=1e-6)
    np.testing.assert_allclose(poses.rotation[7], TURN, atol=1e-6)
    np.testing.assert_allclose(wrenches.force[3], [4, 5, 6])
    assert wrenches.torque is not None
    np.testing.assert_allclose(wrenches.torque[3], [7, 8, 9])


def test_an_interrupt_ends_a_recording(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(count: int) -> None:
        if count >= 10:
            raise KeyboardInterrupt

    with serving([transform(i) for i in range(10)]) as port:
        found = igt.record("127.0.0.1", port, progress=interrupt)
    assert len(found.trajectory()) == 10


def test_nobody_listens() -> None:
    with pytest.raises(InputError, match="no server answers"):
        igt.record("127.0.0.1", free_port(), seconds=1.0, patience=0.2)
    with serving([]) as port, pytest.raises(InputError, match="sends nothing"):
        igt.record("127.0.0.1", port, seconds=1.0, patience=0.3)
    with pytest.raises(InputError, match="65535"):
        igt.record("127.0.0.1", 0)
    with pytest.raises(InputError, match="positive"):
        igt.record("127.0.0.1", 5, seconds=-1.0)


def received(*messages: Any) -> igt.Received:
    out = igt.Received()
    for message in messages:
        out.take(message)
    return out


def test_what_came_is_checked() -> None:
    two = received(transform(0), transform(1, "StylusToTracker"))
    with pytest.raises(InputError, match=r"several devices.*StylusToTracker"):
        two.trajectory()
    with pytest.raises(InputError, match="sent no TRANSFORM: one of"):
        two.trajectory("Needle")
    with pytest.raises(InputError, match="no SENSOR arrived"):
        two.wrenches()
    text = received(pyigtl.StringMessage("hello", device_name="Text"))
    with pytest.raises(InputError, match=r"no TRANSFORM arrived, but Text \(STRING\)"):
        text.trajectory()
    with pytest.raises(InputError, match="sent 3, 6 numbers"):
        received(sensor(0), sensor(1, 3)).wrenches()
    for value in (np.nan, np.inf, 5.0):
        bent = transform(0)
        bent.matrix[0, 0] = value
        with pytest.raises(InputError, match="Probe"):
            received(bent).trajectory()
    assert received(sensor(0, 3), sensor(1, 3)).wrenches().torque is None
    again = received(transform(1), transform(0), transform(1)).trajectory()
    np.testing.assert_allclose(again.time, [50.0, 50.1], atol=1e-6)


@pytest.mark.parametrize("n", [60, pytest.param(3000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", ["pose", "force"])
def test_mutations(kind: str, n: int) -> None:
    """Damaged messages that pyigtl reads all the same: our errors and no other."""
    sent = [transform(i) if kind == "pose" else sensor(i) for i in range(3)]
    content = b"".join(message.pack() for message in sent)
    rng = np.random.default_rng(SEED)
    head = pyigtl.messages.MessageBase.IGTL_HEADER_SIZE
    taken = 0
    for _ in range(n):
        data, found = mutated(content, rng), igt.Received()
        while len(data) >= head:
            with contextlib.suppress(Exception):  # pyigtl closes the connection
                fields = pyigtl.messages.MessageBase.parse_header(data[:head])
                end = head + fields["body_size"]
                message = KINDS[fields["message_type"]]()
                message.unpack(fields, data[head:end])
                found.take(message)
                data = data[end:]
                continue
            break
        taken += found.count
        for read in (found.trajectory, found.wrenches):
            try:
                read()
            except TtusError as error:
                assert "\n" not in str(error)
    assert taken > n / 4


class Nonsense:
    def pack(self) -> bytes:
        return b"\xff" * 58


def test_a_server_that_sends_nonsense(capfd: pytest.CaptureFixture[str]) -> None:
    """What came before is kept, and one line says what happened: no traceback."""
    sent = [*(transform(i) for i in range(5)), Nonsense()]
    with (
        serving(sent) as port,
        pytest.warns(
            TtusWarning, match="not an OpenIGTLink message .* after 5"
        ) as told,
    ):
        found = igt.record("127.0.0.1", port, seconds=30.0)
    assert len(found.trajectory()) == 5
    assert "\n" not in str(told[0].message)
    with (
        serving([Nonsense()]) as port,
        pytest.raises(InputError, match="another server or port") as error,
    ):
        igt.record("127.0.0.1", port, seconds=30.0)
    assert "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")
