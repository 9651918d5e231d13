"""Live recording over OpenIGTLink, for a given time or until Ctrl-C.

TRANSFORM messages are poses (translations in mm, as PLUS and 3D Slicer send them);
SENSOR messages of 3 or 6 numbers are forces, or forces and torques [N, N·m]. Times are
the messages' time stamps. Needs the extra ``live`` (pyigtl).
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.errors import InputError, located, warn
from ttus_opt.optional import load
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.sensors.streams import WrenchStream

#: Default port of PLUS
PORT = 18944

#: Unit of translations in OpenIGTLink [m]
MILLIMETRE = 1e-3

#: Time limit for a connection and for a first message [s]
PATIENCE = 5.0

#: Most messages of a recording, hours of them
MOST_MESSAGES = 5_000_000

#: Polling interval [s]
PAUSE = 0.02


@dataclass
class Received:
    """Messages of a recording, by device, in the order received.

    Attributes:
        poses: Times [s] and matrices (4, 4) [–, mm].
        readings: Times [s] and numbers.
        others: Message types that are neither, by device.
        count: Number of messages.
        broken: Why no further message could be read; None while reading works.
    """

    poses: dict[str, list[tuple[float, Array]]] = field(default_factory=dict)
    readings: dict[str, list[tuple[float, Array]]] = field(default_factory=dict)
    others: dict[str, str] = field(default_factory=dict)
    count: int = 0
    broken: str | None = None

    def take(self, message: Any) -> None:
        """Keep a message."""
        self.count += 1
        device, at = str(message.device_name), float(message.timestamp)
        if message.message_type == "TRANSFORM":
            kept, value = self.poses, np.array(message.matrix, np.float64)
        elif message.message_type == "SENSOR":
            kept, value = self.readings, np.array(message.values, np.float64)
        else:
            self.others[device] = str(message.message_type)
            return
        kept.setdefault(device, []).append((at, value))

    def trajectory(self, device: str | None = None) -> Trajectory:
        """Poses of a device.

        Args:
            device: May be left out where only one sent poses.

        Raises:
            InputError: No such device, several to choose from, or messages that are not
                poses.
        """
        name, time_, values = _stream(self.poses, device, "TRANSFORM", self.others)
        matrices = np.array(values)
        if not np.abs(matrices).max() < 1e6:
            raise InputError(f"{name} sent NaN, infinity or shifts beyond a kilometre")
        position = MILLIMETRE * matrices[:, :3, 3]
        with located(f"{name} sent no rigid motion"):
            return Trajectory(time_, position, matrices[:, :3, :3].copy())

    def wrenches(self, device: str | None = None) -> WrenchStream:
        """Forces, and torques where sent, of a device.

        Args:
            device: May be left out where only one sent readings.

        Raises:
            InputError: As `trajectory`, or neither 3 nor 6 numbers.
        """
        name, time_, values = _stream(self.readings, device, "SENSOR", self.others)
        sizes = {len(value) for value in values}
        if sizes not in ({3}, {6}):
            raise InputError(
                f"{name} sent {', '.join(map(str, sorted(sizes)))} numbers, expected "
                "always 3 forces, or always 3 forces and 3 torques"
            )
        numbers = np.array(values)
        torque = numbers[:, 3:].copy() if sizes == {6} else None
        with located(name):
            return WrenchStream(time_, numbers[:, :3].copy(), torque)


def record(
    host: str,
    port: int = PORT,
    *,
    seconds: float | None = None,
    patience: float = PATIENCE,
    progress: Callable[[int], None] | None = None,
) -> Received:
    """Record the messages of a server.

    Args:
        host: Name or address of the server.
        port: Its port.
        seconds: Duration from the first message; None to record until interrupted.
        patience: Time limit for a connection and for a first message [s].
        progress: Called with the number of messages, many times a second.

    Returns:
        The messages. An interrupt (Ctrl-C) ends the recording without loss; so does
        data that is not a message, with a warning.

    Raises:
        InputError: No server, no messages, or not OpenIGTLink.
        MissingPackageError: pyigtl is not installed.
    """
    if not (1 <= port <= 65535 and 0.0 < patience < np.inf):
        raise InputError(f"a port must be 1 to 65535, got {port}")
    if seconds is not None and not 0.0 < seconds < np.inf:
        raise InputError(
            f"the duration of a recording must be positive [s], got {seconds}"
        )
    received = Received()
    igtl: Any = load("pyigtl", "live")
    try:
        connection = socket.create_connection((host, port), timeout=patience)
    except (OSError, UnicodeError) as error:
        raise InputError(
            f"no server answers at {host}:{port}: check host, port and server"
        ) from error
    lasts = np.inf if seconds is None else seconds
    listening = _listening(igtl, connection, received)
    with listening, contextlib.suppress(KeyboardInterrupt):
        _wait(received, lasts, patience, progress)
    _check(received, f"{host}:{port}")
    return received


def _wait(
    received: Received,
    lasts: float,
    patience: float,
    progress: Callable[[int], None] | None,
) -> None:
    """Wait until the time is over, nothing comes, or nothing more can be read."""
    begun: float | None = None
    asked = time.monotonic()
    while begun is None or time.monotonic() - begun < lasts:
        time.sleep(PAUSE)
        if received.count > MOST_MESSAGES or received.broken is not None:
            break
        if begun is None and received.count:
            begun = time.monotonic()
        if begun is None and time.monotonic() - asked > patience:
            break
        if progress is not None:
            progress(received.count)


def _check(received: Received, server: str) -> None:
    """Warn of a recording that broke off.

    Raises:
        InputError: There are no messages.
    """
    what = f"{server} sent what is not an OpenIGTLink message ({received.broken})"
    if received.count == 0:
        raise InputError(
            f"{server} sends nothing: is the server recording?"
            if received.broken is None
            else f"{what}: another server or port?"
        )
    if received.broken is not None:
        warn(
            f"{what} after {received.count} messages, where the recording ends: what "
            "came before is kept",
            2,
        )


@contextlib.contextmanager
def _listening(
    igtl: Any, connection: socket.socket, received: Received
) -> Iterator[None]:
    """A client that keeps every message; pyigtl itself keeps only the latest."""
    _register_sensor(igtl)

    class Messages(dict[str, Any]):
        """Passes on what the client's thread writes."""

        def __setitem__(self, device: str, message: Any) -> None:
            received.take(message)

    class Client(igtl.OpenIGTLinkClient):
        """Stops at a message it cannot read; pyigtl prints a traceback and goes on."""

        def _receive_message_from_socket(self, ssocket: socket.socket) -> bool:
            try:
                return bool(super()._receive_message_from_socket(ssocket))
            except Exception as error:  # struct.error, KeyError, UnicodeError, …
                received.broken = f"{type(error).__name__}: {error}".splitlines()[0]
                self.communication_thread_stop_requested = True
                return False

    client = Client(*connection.getpeername()[:2], start_now=False)
    client.incoming_messages = Messages()
    connection.settimeout(PAUSE)
    client.socket, client._connected = connection, True
    client.start()
    try:
        yield
    finally:
        # pyigtl's stop() waits forever for a thread that has died
        client.communication_thread_stop_requested = True
        client._client_thread.join(timeout=2.0)
        connection.close()


_REGISTERING = threading.Lock()


def _register_sensor(igtl: Any) -> None:
    """Add SENSOR messages, which pyigtl does not know (OpenIGTLink v2, sensor)."""
    known = igtl.messages.message_type_to_class_constructor
    with _REGISTERING:
        if "SENSOR" not in known:
            known["SENSOR"] = sensor_message(igtl)


def sensor_message(igtl: Any) -> Any:
    """The class of SENSOR messages, with ``values`` [N, N·m]; igtl is pyigtl itself."""

    class SensorMessage(igtl.messages.MessageBase):
        """Count, status, unit, then ``count`` doubles."""

        def __init__(self, values: Any = (), **more: Any) -> None:
            super().__init__(**more)
            self._message_type = "SENSOR"
            self.values = np.asarray(values, np.float64).reshape(-1)
            self._valid_message = True

        def _pack_content(self) -> bytes:
            head = struct.pack("> B B Q", len(self.values), 0, 0)
            return head + self.values.astype(">f8").tobytes()

        def _unpack_content(self, content: bytes) -> None:
            count, _, _ = struct.unpack_from("> B B Q", content)
            self.values = np.frombuffer(content, ">f8", count, 10).astype(np.float64)

    return SensorMessage


def _stream(
    kept: dict[str, list[tuple[float, Array]]],
    device: str | None,
    kind: str,
    others: dict[str, str],
) -> tuple[str, Array, list[Array]]:
    """Messages of a device by time, one per time stamp.

    Raises:
        InputError: No such device, or several to choose from.
    """
    if not kept:
        listed = ", ".join(f"{name} ({what})" for name, what in others.items())
        came = f", but {listed}" if listed else ""
        raise InputError(f"no {kind} arrived{came}: what does the server send?")
    if device is None and len(kept) > 1:
        raise InputError(f"several devices sent {kind}: name one of {', '.join(kept)}")
    name = next(iter(kept)) if device is None else device
    if name not in kept:
        raise InputError(f"{name} sent no {kind}: one of {', '.join(kept)}")
    stamps = np.array([at for at, _ in kept[name]], np.float64)
    stamps, first = np.unique(stamps, return_index=True)
    return name, stamps, [kept[name][i][1] for i in first]
