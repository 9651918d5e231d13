"""The stream of a session: one TCP connection after another, whoever proved the key.

The follower waits at a port, the operator calls it, and calls again where the stream
broke. On every connection each side greets; the one that called then seals an empty
message, which nobody without the session's key can make and which an earlier
connection's recording does not hold. Until it has arrived the connection is a
stranger's: little of it is read, and it takes no other's place.
"""

from __future__ import annotations

import socket
import struct

from ttus_opt.core.errors import InputError
from ttus_opt.live.messages import LONGEST
from ttus_opt.live.sealing import SealedChannel

_LENGTH = struct.Struct("<I")

#: Longest sealed message; most bytes waiting to be sent or read; most bytes that are
#: read before the key is proved, ten times what the proof needs [bytes]
MOST, WAITING, UNPROVED = LONGEST + 64, 4 * LONGEST, 1024


class SealedStream:
    """One end of a connection, which never blocks.

    Attributes:
        broken: Whether it has ended, or the other side is not one of ours.
    """

    def __init__(self, connection: socket.socket, key: bytes, *, calls: bool) -> None:
        """Greet on a connection, which is closed with this object.

        Args:
            connection: Connected, or connecting.
            key: The session's key.
            calls: Whether this is the side that calls, the operator's.
        """
        connection.setblocking(False)
        self._socket, self._calls = connection, calls
        self._sealed = SealedChannel(key, calls=calls, purpose="stream")
        self._in, self._out, self._read = bytearray(), bytearray(), 0
        self._proves = calls
        self.broken = False
        self._frame(self._sealed.greeting())

    @property
    def greeted(self) -> bool:
        """Whether a greeting made with the key has come, perhaps a recorded one."""
        return self._sealed.ready

    @property
    def proved(self) -> bool:
        """Whether the other side has proved that it has the key, now."""
        return self._sealed.confirmed

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()

    def send(self, waiting: list[bytes]) -> None:
        """Send messages, which leave the list as they are taken, as far as they go."""
        if self._sealed.ready:
            if self._proves:
                self._proves = False
                self._frame(self._sealed.seal(b""))
            while waiting and len(self._out) < WAITING:
                self._frame(self._sealed.seal(waiting.pop(0)))
        try:
            while self._out:
                sent = self._socket.send(self._out[:65536])
                del self._out[:sent]
        except (BlockingIOError, InterruptedError):
            pass
        except OSError:
            self._judge()

    def receive(self) -> list[bytes]:
        """Whole messages that have arrived."""
        arrived: list[bytes] = []
        try:
            while not self.broken and len(self._in) < WAITING:
                content = self._socket.recv(self._allowed)
                self.broken = not content
                self._read += len(content)
                self._in += content
                if not self.proved and not self._calls:
                    arrived += self._unframed()
                    self.broken |= not self.proved and self._read >= UNPROVED
        except (BlockingIOError, InterruptedError):
            pass
        except OSError:  # not connected yet, or broken
            self._judge()
        return arrived + self._unframed()

    @property
    def _allowed(self) -> int:
        """Bytes to read at once: few of a stranger."""
        return 65536 if self.proved or self._calls else UNPROVED - self._read

    def _unframed(self) -> list[bytes]:
        """The whole messages among the bytes read."""
        arrived = []
        while len(self._in) >= _LENGTH.size and not self.broken:
            (length,) = _LENGTH.unpack(self._in[: _LENGTH.size])
            end = _LENGTH.size + length
            if length > MOST:
                self.broken = True
            elif len(self._in) < end:
                break
            else:
                content = self._sealed.open(bytes(self._in[_LENGTH.size : end]))
                del self._in[:end]
                # nothing is lost or doubled on a stream: what does not open is foreign
                self.broken = self._sealed.refused > 0
                if content:
                    arrived.append(content)
        return arrived

    def _judge(self) -> None:
        """After an error: broken, unless still connecting."""
        error = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        self.broken |= error != 0

    def _frame(self, data: bytes) -> None:
        self._out += _LENGTH.pack(len(data)) + data


#: Time between attempts to connect [s]
RETRY = 0.5

#: Time that a connection has to prove the session's key [s], far longer than a round
#: trip; most connections that have not, of which the eldest silent one gives way [–]
PROOF, STRANGERS = 5.0, 16


class SessionStream:
    """One side of the stream.

    Attributes:
        port: Port of the follower.
        opened: Connections so far that became the stream, or were called [–].
    """

    def __init__(self, key: bytes, host: str, port: int, *, calls: bool) -> None:
        """Wait at a port, or prepare to call one.

        Args:
            key: The session's key.
            host: Address of the follower to call, or own address to wait at.
            port: Its port; 0 for any free one when waiting.
            calls: Whether this is the operator, who calls.

        Raises:
            InputError: The address cannot be used.
        """
        self._key, self.port, self.opened = key, port, 0
        self._waiting: list[bytes] = []
        self._stream: SealedStream | None = None
        self._strangers: dict[SealedStream, float] = {}  # since when
        self._arrived: list[bytes] = []  # with the proof of a new stream
        self._tried = -1e9
        self._listener: socket.socket | None = None
        try:
            self._host = socket.gethostbyname(host)
            if not calls:
                self._listener = socket.create_server((self._host, port))
                self._listener.setblocking(False)
                self.port = self._listener.getsockname()[1]
        except OSError as error:
            raise unusable(host, port, error) from error

    @property
    def ready(self) -> bool:
        """Whether the other side has greeted on the present connection."""
        return self._stream is not None and self._stream.greeted

    def send(self, messages: list[bytes]) -> None:
        """Send messages, as far as they go; the newest wait where nobody listens."""
        self._waiting += messages
        del self._waiting[:-16]
        if self._stream is not None:
            self._stream.send(self._waiting)
            self._drop_broken()

    def receive(self, now: float) -> list[bytes]:
        """What has arrived, after calling or accepting connections."""
        if self._listener is not None:
            self._accept(self._listener, now)
        else:
            self._connect(now)
        arrived, self._arrived = self._arrived, []
        if self._stream is not None:
            arrived += self._stream.receive()
            self._drop_broken()
        return arrived

    def close(self) -> None:
        """Close the connections."""
        for one in (self._stream, self._listener, *self._strangers):
            if one is not None:
                one.close()

    def _connect(self, now: float) -> None:
        """Open the stream anew where there is none."""
        if self._stream is not None or now - self._tried < RETRY:
            return
        self._tried = now
        connection = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        connection.setblocking(False)
        try:
            connection.connect((self._host, self.port))
        except BlockingIOError:
            pass
        except OSError:  # no way there now
            connection.close()
            return
        self._stream = SealedStream(connection, self._key, calls=True)
        self.opened += 1

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
                self.opened += 1
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

    def _drop_broken(self) -> None:
        if self._stream is not None and self._stream.broken:
            self._stream.close()
            self._stream = None


def unusable(host: str, port: int, error: OSError) -> InputError:
    """An address that cannot be used."""
    return InputError(f"{host}:{port} cannot be used: {error.strerror}")
