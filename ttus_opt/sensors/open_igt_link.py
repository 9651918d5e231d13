"""Live recording over OpenIGTLink, for a given time or until Ctrl-C.

TRANSFORM, POSITION and TDATA messages are poses (translations in mm, as PLUS and 3D
Slicer send them), those of TDATA by the names of its tools; SENSOR and NDARRAY messages
of 3 or 6 numbers are forces, or forces and torques [N, N·m]. Times are the messages'
time stamps.
"""

from __future__ import annotations

import contextlib
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from ttus_opt.core.arguments import expect_positive
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError, located, warn
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.sensors.open_igt_message import (
    POSES,
    READINGS,
    Message,
    MessageReader,
)
from ttus_opt.sensors.streams import WrenchStream

#: Default port of PLUS
PORT = 18944

#: Unit of translations in OpenIGTLink [m]
MILLIMETRE = 1e-3

#: Time limit for a connection and for a first message [s]
PATIENCE = 5.0

#: Silence that is told, and that ends a recording within a message [s]
SILENCE = 1.5

#: What came is kept this often, less often where keeping takes a fifth of it [s]
KEEPING = 5.0

#: Most messages of a recording, hours of them
MOST_MESSAGES = 5_000_000

#: Longest wait for bytes before the clock is looked at [s]
PAUSE = 0.02


@dataclass
class Received:
    """Messages of a recording, by device, in the order received.

    Attributes:
        poses: Times [s] and matrices (4, 4) [–, mm].
        readings: Times [s] and numbers.
        others: Message types that are neither, by device.
        dropped: Numbers of messages that could not be used, by their fault.
        count: Number of messages.
        ended: Why the recording ended before its time; empty where it did not.
    """

    poses: dict[str, list[tuple[float, Array]]] = field(default_factory=dict)
    readings: dict[str, list[tuple[float, Array]]] = field(default_factory=dict)
    others: dict[str, str] = field(default_factory=dict)
    dropped: Counter[str] = field(default_factory=Counter)
    count: int = 0
    ended: str = ""

    def take(self, message: Message) -> None:
        """Keep a message, or count it as dropped."""
        self.count += 1
        if message.fault:
            self.dropped[message.fault] += 1
            return
        if message.kind not in (*POSES, *READINGS):
            self.others[message.device] = message.kind
            return
        kind = self.poses if message.kind in POSES else self.readings
        kept = kind.setdefault(message.device, [])
        if kept and len(kept[0][1]) != len(message.values):
            self.dropped["fewer or more numbers than the first"] += 1
            return
        kept.append((message.time, message.values))

    def trajectory(self, device: str | None = None) -> Trajectory:
        """Poses of a device.

        Args:
            device: May be left out where only one sent poses.

        Raises:
            InputError: No such device, or several to choose from.
        """
        name, at, matrices = _stream(self.poses, device, "poses", self.others)
        position = MILLIMETRE * matrices[:, :3, 3]
        with located(name):
            return Trajectory(at, position, matrices[:, :3, :3].copy())

    def wrenches(self, device: str | None = None) -> WrenchStream:
        """Forces, and torques where sent, of a device.

        Args:
            device: May be left out where only one sent readings.

        Raises:
            InputError: As `trajectory`, a single reading, or counts for newtons.
        """
        name, at, numbers = _stream(self.readings, device, "forces", self.others)
        torque = numbers[:, 3:].copy() if numbers.shape[1] == 6 else None
        with located(name):
            return WrenchStream(at, numbers[:, :3].copy(), torque)


def record(
    host: str,
    port: int = PORT,
    *,
    seconds: float | None = None,
    patience: float = PATIENCE,
    progress: Callable[[int], None] | None = None,
    keep: Callable[[Received], None] | None = None,
) -> Received:
    """Record the messages of a server.

    A message with a wrong checksum, or numbers that are no pose and no reading, is
    dropped and counted. A server that sends nothing for `SILENCE` is named at once, and
    recording goes on: a tracker may say nothing of a probe it does not see.

    Args:
        host: Name or address of the server.
        port: Its port.
        seconds: Duration from the first message; None to record until interrupted.
        patience: Time limit for a connection and for a first message [s].
        progress: Called with the number of messages, many times a second.
        keep: Called every `KEEPING` seconds with what came so far.

    Returns:
        The messages. An interrupt (Ctrl-C) ends the recording without loss; so does,
        with a warning, a server that closes the connection, stops within a message or
        sends what is none.

    Raises:
        InputError: No server, no messages, or not OpenIGTLink.
    """
    if not (1 <= port <= 65535 and 0.0 < patience < np.inf):
        raise InputError(f"a port must be 1 to 65535, got {port}")
    if seconds is not None:
        expect_positive(seconds, "the duration of a recording", "s")
    server = f"{host}:{port}"
    try:
        connection = socket.create_connection((host, port), timeout=patience)
    except (OSError, UnicodeError) as error:
        raise InputError(
            f"no server answers at {server}: check host, port and server"
        ) from error
    received = Received()
    lasts = np.inf if seconds is None else seconds
    with connection, contextlib.suppress(KeyboardInterrupt):
        due = np.inf
        for now in _instants(connection, received, lasts, patience):
            if progress is not None:
                progress(received.count)
            due = min(due, now + KEEPING)
            if keep is not None and now >= due:
                keep(received)
                spent = time.monotonic() - now
                due = now + spent + max(KEEPING, 4.0 * spent)
    _check(received, server)
    return received


def _instants(
    connection: socket.socket, received: Received, lasts: float, patience: float
) -> Iterator[float]:
    """The time from the first message on, many times a second, while messages come."""
    begun, asked, told = np.inf, time.monotonic(), 0.0
    for heard in _taken(connection, received):
        now = time.monotonic()
        if not received.count:
            if now - asked > patience:
                return
            continue
        begun = min(begun, now)
        if now - begun >= lasts or received.count > MOST_MESSAGES:
            return
        if now - heard > SILENCE and told != heard:
            told = heard
            warn(
                f"nothing came for {SILENCE:g} s after {received.count} messages: is "
                "the probe in view and the server recording? Ctrl-C ends the recording",
                3,
            )
        yield now


def _taken(connection: socket.socket, received: Received) -> Iterator[float]:
    """Take messages while they come; yields when the last bytes came [s]."""
    reader = MessageReader()
    connection.settimeout(PAUSE)
    heard = time.monotonic()
    while not received.ended:
        yield heard
        try:
            data = connection.recv(2**16)
        except TimeoutError:
            if reader.within_message and time.monotonic() - heard > SILENCE:
                received.ended = "stopped within a message"
            continue
        except OSError as error:
            received.ended = f"broke the connection ({error.strerror or error})"
            continue
        heard = time.monotonic()
        if not data:
            within = " within a message" if reader.within_message else ""
            received.ended = f"closed the connection{within}"
        try:
            for message in reader.feed(data):
                received.take(message)
        except InputError as error:
            received.ended = f"sent what is not an OpenIGTLink message ({error})"


def _check(received: Received, server: str) -> None:
    """Warn of a recording that broke off and of messages that were dropped."""
    if received.count == 0:
        raise InputError(
            f"{server} {received.ended}: another server or port?"
            if received.ended
            else f"{server} sends nothing: is the server recording?"
        )
    if received.dropped:
        faults = ", ".join(f"{n} {fault}" for fault, n in received.dropped.items())
        warn(
            f"{received.dropped.total()} of {received.count} messages were dropped "
            f"({faults})",
            2,
        )
    if received.ended:
        warn(
            f"{server} {received.ended} after {received.count} messages, where the "
            "recording ends: what came before is kept",
            2,
        )


def _stream(
    kept: dict[str, list[tuple[float, Array]]],
    device: str | None,
    kind: str,
    others: dict[str, str],
) -> tuple[str, Array, Array]:
    """Messages of a device by time, one per stamp; a warning where some had one."""
    if not kept:
        listed = ", ".join(f"{name} ({what})" for name, what in others.items())
        came = f", but {listed}" if listed else ""
        raise InputError(f"no {kind} arrived{came}: what does the server send?")
    if device is None and len(kept) > 1:
        raise InputError(
            f"several devices sent {kind}: {', '.join(kept)}: choose one, for instance "
            f"device='{next(iter(kept))}'"
        )
    name = next(iter(kept)) if device is None else device
    if name not in kept:
        raise InputError(f"{name} sent no {kind}: one of {', '.join(kept)}")
    stamps = np.array([at for at, _ in kept[name]], np.float64)
    different, first = np.unique(stamps, return_index=True)
    if more := len(stamps) - len(different):
        warn(
            f"{more} of {len(stamps)} {kind} of {name} have the time stamp of another, "
            "the first of which is kept: does the server stamp what it sends?",
            2,
        )
    return name, different, np.array([kept[name][i][1] for i in first])
