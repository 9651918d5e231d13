"""One TCP connection whose messages are sealed, and who has proved the key.

Each side greets; the one that called then seals an empty message, which nobody without
the session's key can make and which an earlier connection's recording does not hold.
Until it has arrived the connection is a stranger's: little of it is read.
"""

from __future__ import annotations

import socket
import struct

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
