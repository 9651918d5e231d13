"""A session over UDP, with a TCP stream beside it for surface and model, both sealed.

Sockets never block: `send` and `receive` do what can be done now. Of datagrams the
network may lose any, of the stream none; where it breaks both sides greet anew.
"""

from __future__ import annotations

import errno
import socket
from collections.abc import Sequence

from ttus_opt.core.errors import InputError
from ttus_opt.live.messages import LONGEST_DATAGRAM
from ttus_opt.live.peer import Outgoing
from ttus_opt.live.sealing import SealedChannel, looks_sealed
from ttus_opt.live.session_stream import SessionStream, unusable

#: Time between greetings [s]
GREET = 0.2

#: Attempts to find a port that is free for datagrams and streams alike [–]
_TRIES = 16

#: Errors of a datagram that is lost, not of a socket that is unusable
_LOST = (
    *(errno.ECONNREFUSED, errno.EHOSTUNREACH, errno.ENETUNREACH, errno.EAGAIN),
    *(errno.ENETDOWN, errno.ENOBUFS, errno.EADDRNOTAVAIL),
)


class SocketLink:
    """One side of a session over UDP and TCP.

    Attributes:
        port: Port of the follower's sockets.
    """

    #: Headers of IPv4 and UDP, and of encryption [bytes]
    overhead = 28 + 32

    def __init__(self, key: bytes, host: str, port: int, *, calls: bool) -> None:
        """Open the sockets; see `session_stream.SessionStream`."""
        self._address: tuple[str, int] | None = None
        self._calls, self._greeted = calls, -1e9
        self._sealed = SealedChannel(key, calls=calls)
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._udp.setblocking(False)
        try:
            known = socket.gethostbyname(host)
            if calls:
                self._address = known, port
                self._udp.bind(("", 0))
                self._stream = SessionStream(key, known, port, calls=True)
            else:
                self._stream = self._wait_at(key, known, port)
        except OSError as error:
            self._udp.close()
            raise unusable(host, port, error) from error
        except InputError:
            self._udp.close()
            raise
        self.port = self._stream.port

    def send(self, now: float, packets: Sequence[Outgoing]) -> None:
        """Send packets, and greetings until the other side is known."""
        self._greet(now)
        for packet in packets:
            if not packet.reliable and self._sealed.ready and self._address:
                self._sendto(self._sealed.seal(packet.data))
        self._stream.send([packet.data for packet in packets if packet.reliable])

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
            elif self._sealed.greetings > greetings or self._is_of_before(data):
                self._sendto(self._sealed.greeting(), sender)
                if self._sealed.ready and not self._sealed.confirmed:
                    self._address = sender
        return arrived + self._stream.receive(now)

    def close(self) -> None:
        """Close the sockets."""
        self._udp.close()
        self._stream.close()

    def _wait_at(self, key: bytes, host: str, port: int) -> SessionStream:
        """Bind both sockets to one port, for 0 to any that is free in both."""
        tries = 1 if port else _TRIES
        while True:
            stream = SessionStream(key, host, port, calls=False)
            try:
                self._udp.bind((host, stream.port))
                return stream
            except OSError as error:
                stream.close()
                tries -= 1
                if error.errno != errno.EADDRINUSE or not tries:
                    raise

    def _greet(self, now: float) -> None:
        if now - self._greeted < GREET or self._address is None:
            return
        if not self._sealed.confirmed:
            self._greeted = now
            self._sendto(self._sealed.greeting())

    def _is_of_before(self, data: bytes) -> bool:
        """Whether an operator may have sent it who knows the follower before this one.

        It gets a greeting, which is shorter, so that nobody sends more than he gets.
        """
        unmet = not (self._calls or self._sealed.confirmed)
        return unmet and looks_sealed(data) and len(data) > len(self._sealed.greeting())

    def _sendto(self, data: bytes, address: tuple[str, int] | None = None) -> None:
        to = address or self._address
        assert to is not None
        try:
            self._udp.sendto(data, to)
        except OSError as error:
            if error.errno not in _LOST:
                raise InputError(f"the network refuses: {error.strerror}") from error
