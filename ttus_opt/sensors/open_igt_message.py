"""OpenIGTLink messages from a stream of bytes, each body checked by its checksum.

A header of 58 bytes, big-endian: version, type, device, time stamp, size and CRC-64
(ECMA-182) of the body. From version 2 on the body has an extended header before its
content, and metadata after it. Source: OpenIGTLink protocol, header of versions 2 and
3, transform, sensor.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.probe.pose import rotations

HEADER = struct.Struct(">H12s20sIIQQ")
EXTENDED = struct.Struct(">HHII")

#: Larger bodies are not messages; an image has some megabytes [byte]
LARGEST_BODY = 2**28

#: Largest translation of a pose that is believed [mm]
FARTHEST = 1e6


@dataclass(frozen=True)
class Message:
    """A message, as far as it is wanted.

    Attributes:
        kind: TRANSFORM, SENSOR or any other type.
        device: Name of its sender.
        time: Time stamp [s].
        values: A pose (4, 4) [–, mm], or a sensor's numbers; empty for other types
            and faulty messages.
        fault: What is wrong with it; empty for a sound one.
    """

    kind: str
    device: str
    time: float
    values: Array
    fault: str = ""


class MessageReader:
    """Cuts a stream of bytes into messages."""

    def __init__(self) -> None:
        self._unread = bytearray()

    @property
    def within_message(self) -> bool:
        """Whether a message has begun and not ended."""
        return bool(self._unread)

    def feed(self, data: bytes) -> Iterator[Message]:
        """The messages that end with these bytes.

        Raises:
            InputError: The bytes are not OpenIGTLink.
        """
        self._unread += data
        while len(self._unread) >= HEADER.size:
            version, kind, device, second, fraction, size, checksum = (
                HEADER.unpack_from(self._unread)
            )
            word, name = (_text(field) for field in (kind, device))
            known = version in (1, 2) and word.isalnum() and word.isascii()
            if not (known and size <= LARGEST_BODY):
                raise InputError("a header that is none")
            end = HEADER.size + size
            if len(self._unread) < end:
                return
            body = bytes(self._unread[HEADER.size : end])
            del self._unread[:end]
            at = second + fraction / 2**32
            try:
                values, fault = _values(word, version, body, checksum), ""
            except InputError as error:
                values, fault = np.empty(0), str(error)
            yield Message(word, name, at, values, fault)


def _text(padded: bytes) -> str:
    """What stands before the first zero; characters that cannot be printed as one."""
    text = padded.partition(b"\0")[0].decode(errors="replace").rstrip()
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)


def _values(kind: str, version: int, body: bytes, checksum: int) -> Array:
    """Numbers of a body of a type that is wanted.

    Raises:
        InputError: They cannot be used; a few words that do not depend on the numbers.
    """
    read = {"TRANSFORM": _pose, "SENSOR": _readings}.get(kind)
    if read is None:
        return np.empty(0)
    if crc64(body) != checksum:
        raise InputError("wrong checksum")
    try:
        if version > 1:
            begin, head, metadata, _ = EXTENDED.unpack_from(body)
            body = body[begin : len(body) - head - metadata]
        values = read(body)
    except struct.error as error:
        raise InputError("body of another size") from error
    if not np.isfinite(values).all():
        raise InputError("NaN or infinite")
    if values.ndim == 1:
        return values
    if np.abs(values[:3, 3]).max() > FARTHEST:
        raise InputError("shift beyond a kilometre")
    try:
        rotations(values[:3, :3])
    except InputError as error:
        raise InputError("no rigid motion") from error
    return values


def _pose(content: bytes) -> Array:
    """Twelve single-precision numbers, column by column, shape (4, 4)."""
    columns = np.array(struct.unpack(">12f", content)).reshape(4, 3)
    return np.vstack([columns.T, [0.0, 0.0, 0.0, 1.0]])


def _readings(content: bytes) -> Array:
    """Count, status and unit, then that many doubles: 3 forces, or 3 torques more."""
    count, _, _ = struct.unpack_from(">BBQ", content)
    if count not in (3, 6):
        raise InputError("neither 3 forces nor 3 forces and 3 torques")
    return np.array(struct.unpack(f">{count}d", content[10:]))


def crc64(data: bytes) -> int:
    """CRC-64 of ECMA-182.

    >>> hex(crc64(b"123456789"))
    '0x6c40df5f0b497347'
    """
    table, found = _table(), 0
    for byte in data:
        found = (found << 8) & 0xFFFFFFFFFFFFFFFF ^ table[found >> 56 ^ byte]
    return found


@functools.cache
def _table() -> list[int]:
    """Remainders of all bytes by the polynomial."""
    remainders = []
    for byte in range(256):
        found = byte << 56
        for _ in range(8):
            found = found << 1 ^ (found >> 63) * 0x142F0E1EBA9EA3693
        remainders.append(found)
    return remainders
