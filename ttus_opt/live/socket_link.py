"""A session over UDP, with a TCP stream beside it for surface and model, both sealed.

The follower waits at a port, the operator calls it. Sockets never block: `send` and
`receive` do what can be done now. Of datagrams the network may lose any, of the stream
none; a stream that breaks is opened again by the operator, and both sides greet anew.
A connection is heard once it has proved the key, and only then takes the place of the
one before, so that a stranger ends no session.
"""

from __future__ import annotations

import errno
import socket
from collections.abc import Sequence

from ttus_opt.core.errors import InputError
from ttus_opt.live.messages import LONGEST_DATAGRAM
from ttus_opt.live.peer import Outgoing
from ttus_opt.live.sealed_stream import SealedStream
from ttus_opt.live.sealing import SealedChannel

#: Time between greetings, and between attempts to connect [s]
GREET, RETRY = 0.2, 0.5

#: Time that a connection has to prove the session's key [s], far longer than a round
#: trip; most connections that have not, of which the eldest silent one gives way [–]
PROOF, STRANGERS = 5.0, 16

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
        self._stream: SealedStream | None = None
        self._strangers: dict[SealedStream, float] = {}  # since when
        self._arrived: list[bytes] = []  # with the proof of a new stream
        self._greeted = self._tried = -1e9
        self._listener: socket.socket | None = None
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
        if self._listener is not None:
            self._accept(self._listener, now)
        else:
            self._connect(now)
        arrived += self._read()
        return arrived

    def close(self) -> None:
        """Close the sockets."""
        for one in (self._udp, self._stream, self._listener, *self._strangers):
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

    def _connect(self, now: float) -> None:
        """Open the stream anew where there is none."""
        if self._stream is not None or now - self._tried < RETRY:
            return
        self._tried = now
        assert self._address is not None
        connection = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        connection.setblocking(False)
        try:
            connection.connect(self._address)
        except BlockingIOError:
            pass
        except OSError:  # no way there now
            connection.close()
            return
        self._stream = SealedStream(connection, self._key, calls=True)

    def _accept(self, listener: socket.socket, now: float) -> None:
        """Take connections; the stream is the newest one that proved the key."""
        for _ in range(STRANGERS):
            try:
                connection, _ = listener.accept()
            except OSError:  # none, or gone already
                break
            stranger = SealedStream(connection, self._key, calls=False)
            self._strangers[stranger] = now
        for stranger, since in list(self._strangers.items()):
            stranger.send([])
            arrived = stranger.receive()
            if stranger.proved and not stranger.broken:
                if self._stream is not None:
                    self._stream.close()
                self._stream = stranger
                self._arrived += arrived
                del self._strangers[stranger]
            elif stranger.broken or now - since > PROOF:
                self._refuse(stranger)
        while len(self._strangers) > STRANGERS:  # a greeting needs the key once
            strangers = list(self._strangers)
            silent = (one for one in strangers if not one.greeted)
            self._refuse(next(silent, strangers[0]))

    def _refuse(self, stranger: SealedStream) -> None:
        stranger.close()
        del self._strangers[stranger]

    def _read(self) -> list[bytes]:
        """What has arrived on the stream."""
        arrived, self._arrived = self._arrived, []
        if self._stream is not None:
            arrived += self._stream.receive()
            self._drop_broken()
        return arrived

    def _write(self) -> None:
        if self._stream is not None:
            self._stream.send(self._waiting)
            self._drop_broken()

    def _drop_broken(self) -> None:
        if self._stream is not None and self._stream.broken:
            self._stream.close()
            self._stream = None
