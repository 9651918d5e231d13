"""A session over UDP, with a TCP stream beside it for surface and model, both sealed.

The follower waits at a port, the operator calls it. Sockets never block: `send` and
`receive` do what can be done now. Of datagrams the network may lose any, of the stream
none; a stream that breaks is opened again by the operator, and both sides greet anew.
"""

from __future__ import annotations

import contextlib
import errno
import socket
import struct
from collections.abc import Sequence

from ttus_opt.core.errors import InputError
from ttus_opt.live.messages import LONGEST, LONGEST_DATAGRAM
from ttus_opt.live.peer import Outgoing
from ttus_opt.live.sealing import SealedChannel

_LENGTH = struct.Struct("<I")

#: Time between greetings, and between attempts to connect [s]
GREET, RETRY = 0.2, 0.5

#: Longest sealed message; most bytes waiting to be sent or read [bytes]
MOST, WAITING = LONGEST + 64, 4 * LONGEST

#: Errors of a datagram that is lost, not of a socket that is unusable
_LOST = (errno.ECONNREFUSED, errno.EHOSTUNREACH, errno.ENETUNREACH, errno.EAGAIN)


class SocketLink:
    """One side of a session over UDP and TCP.

    Attributes:
        port: Port of the follower's sockets.
    """

    def __init__(self, key: bytes, host: str, port: int, *, calls: bool) -> None:
        """Open the sockets.

        Args:
            key: The session's key.
            host: Address of the follower to call, or own address to wait at.
            port: Its port; 0 for any free one when waiting.
            calls: Whether this is the operator, who calls.

        Raises:
            InputError: The address cannot be used.
        """
        self._key, self._calls = key, calls
        self._address: tuple[str, int] | None = None
        self._waiting: list[bytes] = []  # for the stream
        self._stream: socket.socket | None = None
        self._greeted = self._tried = -1e9
        self._listener: socket.socket | None = None
        self._reset_stream()
        self._sealed = SealedChannel(key, calls=calls)
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._udp.setblocking(False)
        try:
            host = socket.gethostbyname(host)
            if calls:
                self._address, self.port = (host, port), port
                self._udp.bind(("", 0))
            else:
                self._udp.bind((host, port))
                self.port = self._udp.getsockname()[1]
                self._listener = socket.create_server((host, self.port))
                self._listener.setblocking(False)
        except OSError as error:
            self.close()
            raise InputError(
                f"{host}:{port} cannot be used: {error.strerror}"
            ) from error

    def send(self, now: float, packets: Sequence[Outgoing]) -> None:
        """Send packets, and greetings until the other side is known."""
        self._greet(now)
        for packet in packets:
            if packet.reliable:
                self._waiting.append(packet.data)
                del self._waiting[:-16]  # newest count, where nobody listens
            elif self._sealed.ready and self._address:
                self._sendto(self._sealed.seal(packet.data))
        self._write()

    def receive(self, now: float) -> list[bytes]:
        """What has arrived."""
        arrived: list[bytes] = []
        for _ in range(256):
            try:
                data, sender = self._udp.recvfrom(LONGEST_DATAGRAM + 64)
            except (BlockingIOError, ConnectionError):
                break
            greetings = self._sealed.greetings
            content = self._sealed.open(data)
            if content is not None:
                self._address = sender  # authentic: answers go there
                arrived.append(content)
            elif self._sealed.greetings > greetings:
                self._sendto(self._sealed.greeting(), sender)
            self._address = self._address or sender
        self._connect(now)
        arrived += self._read()
        return arrived

    def close(self) -> None:
        """Close the sockets."""
        for one in (self._udp, self._stream, self._listener):
            if one is not None:
                one.close()

    def _greet(self, now: float) -> None:
        if now - self._greeted < GREET or self._address is None:
            return
        if not self._sealed.confirmed:
            self._greeted = now
            self._sendto(self._sealed.greeting())

    def _sendto(self, data: bytes, address: tuple[str, int] | None = None) -> None:
        to = address or self._address
        assert to is not None
        try:
            self._udp.sendto(data, to)
        except OSError as error:
            if error.errno not in _LOST:
                raise InputError(f"the network refuses: {error.strerror}") from error

    def _reset_stream(self) -> None:
        """Begin a stream anew, with new keys."""
        if self._stream is not None:
            self._stream.close()
        self._stream = None
        self._framed = SealedChannel(self._key, calls=self._calls, purpose="stream")
        self._in, self._out, self._hailed = bytearray(), bytearray(), False

    def _connect(self, now: float) -> None:
        """Open the stream, or take a newly opened one."""
        if self._listener is not None:
            with contextlib.suppress(BlockingIOError):
                fresh, _ = self._listener.accept()
                self._reset_stream()
                fresh.setblocking(False)
                self._stream = fresh
        elif self._stream is None and now - self._tried >= RETRY:
            self._tried = now
            assert self._address is not None
            stream = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            stream.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                stream.connect(self._address)
            self._reset_stream()
            self._stream = stream

    def _read(self) -> list[bytes]:
        if self._stream is None:
            return []
        try:
            while len(self._in) < WAITING:
                content = self._stream.recv(65536)
                if not content:
                    self._reset_stream()
                    return []
                self._in += content
        except (BlockingIOError, InterruptedError):
            pass
        except OSError:  # not connected yet, or broken
            if not self._connecting():
                self._reset_stream()
            return []
        return self._unframed()

    def _unframed(self) -> list[bytes]:
        """The whole messages that have arrived on the stream."""
        arrived = []
        while len(self._in) >= _LENGTH.size:
            (length,) = _LENGTH.unpack(self._in[: _LENGTH.size])
            if length > MOST:
                self._reset_stream()  # not a side of ours
                break
            if len(self._in) < _LENGTH.size + length:
                break
            data = bytes(self._in[_LENGTH.size : _LENGTH.size + length])
            del self._in[: _LENGTH.size + length]
            content = self._framed.open(data)
            if content is not None:
                arrived.append(content)
        return arrived

    def _connecting(self) -> bool:
        assert self._stream is not None
        return self._stream.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) == 0

    def _write(self) -> None:
        if self._stream is None:
            return
        if not self._hailed:
            self._hailed = True
            self._frame(self._framed.greeting())
        if self._framed.ready:
            for data in self._waiting:
                self._frame(self._framed.seal(data))
            self._waiting.clear()
        try:
            while self._out:
                sent = self._stream.send(self._out[:65536])
                del self._out[:sent]
        except (BlockingIOError, InterruptedError):
            pass
        except OSError:
            if not self._connecting():
                self._reset_stream()

    def _frame(self, data: bytes) -> None:
        self._out += _LENGTH.pack(len(data)) + data
