"""OpenIGTLink messages from a stream of bytes, each body checked by its checksum.

A header of 58 bytes, big-endian: version, type, device, time stamp, size and CRC-64
(ECMA-182) of the body. From version 2 on the body has an extended header before its
content, and metadata after it. Source: OpenIGTLink protocol, header of versions 2 and
3, transform, position, tracking data, sensor, and array.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.probe.pose import from_quaternions, nearest_rotations
from ttus_opt.probe.rigid_motion import homogeneous

HEADER = struct.Struct(">H12s20sIIQQ")
EXTENDED = struct.Struct(">HHII")

#: Larger bodies are not messages; an image has some megabytes [byte]
LARGEST_BODY = 2**28

#: Largest translation of a pose that is believed [mm]
FARTHEST = 1e6

#: Poses or readings, each with the name of its tool, empty for the sender's
Named = Iterable[tuple[str, Array]]


@dataclass(frozen=True)
class Message:
    """A message, as far as it is wanted.

    Attributes:
        kind: Type of message; those of `READ` have values.
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
            sent = Message(word, name, second + fraction / 2**32, np.empty(0))
            yield from _read(sent, version, body, checksum)


def _text(padded: bytes) -> str:
    """What stands before the first zero; characters that cannot be printed as one."""
    text = padded.partition(b"\0")[0].decode(errors="replace").rstrip()
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)


def _read(sent: Message, version: int, body: bytes, checksum: int) -> Iterator[Message]:
    """A message with its values or its fault; of TDATA one for every tool.

    A fault is a few words that do not depend on the numbers.
    """
    read = READ.get(sent.kind)
    if read is None:
        yield sent
        return
    try:
        found = list(read(_content(version, body, checksum)))
    except (struct.error, ValueError) as error:
        told = str(error) if isinstance(error, InputError) else "body of another size"
        yield replace(sent, fault=told)
        return
    for tool, values in found:
        own = replace(sent, device=tool or sent.device)
        try:
            yield replace(own, values=_checked(values))
        except InputError as error:
            yield replace(own, fault=str(error))


def _content(version: int, body: bytes, checksum: int) -> bytes:
    """A body without its extended header and metadata."""
    if crc64(body) != checksum:
        raise InputError("wrong checksum")
    if version == 1:
        return body
    begin, head, metadata, _ = EXTENDED.unpack_from(body)
    return body[begin : len(body) - head - metadata]


def _checked(values: Array) -> Array:
    """The numbers, a pose with its rotation made orthonormal."""
    if not np.isfinite(values).all():
        raise InputError("NaN or infinite")
    if values.ndim == 1:
        return values
    if np.abs(values[:3, 3]).max() > FARTHEST:
        raise InputError("shift beyond a kilometre")
    try:
        turn, _ = nearest_rotations(values[None, :3, :3])
    except InputError as error:
        raise InputError("no rigid motion") from error
    return homogeneous(turn[0], values[:3, 3])


def _pose(content: bytes) -> Array:
    """Twelve single-precision numbers, column by column, shape (4, 4)."""
    columns = np.array(struct.unpack(">12f", content)).reshape(4, 3)
    return homogeneous(columns[:3].T, columns[3])


def _position(content: bytes) -> Array:
    """Three numbers, and a quaternion x, y, z, w or its first three, (4, 4)."""
    count = len(content) // 4
    if count not in (6, 7):
        raise InputError("a position without orientation")
    x, y, z, *turn = struct.unpack(f">{count}f", content[: 4 * count])
    if count == 6:  # compressed: the scalar part is the positive rest
        turn.append(max(0.0, 1.0 - sum(q * q for q in turn)) ** 0.5)
    try:
        rotation = from_quaternions(np.array([turn]), "xyzw")[0]
    except InputError as error:
        raise InputError("no rigid motion") from error
    return homogeneous(rotation, np.array([x, y, z]))


def _readings(content: bytes) -> Array:
    """Count, status and unit, then that many doubles: 3 forces, or 3 torques more."""
    count, _, _ = struct.unpack_from(">BBQ", content)
    if count not in (3, 6):
        raise InputError("neither 3 forces nor 3 forces and 3 torques")
    return np.array(struct.unpack(f">{count}d", content[10:]))


def _array(content: bytes) -> Array:
    """Type, dimensions and sizes, then the numbers, 3 or 6 of them."""
    kind, n_dims = struct.unpack_from(">BB", content)
    sizes = struct.unpack_from(f">{n_dims}H", content, 2)
    if kind not in ARRAY_TYPES:
        raise InputError("an array of an unknown type")
    if int(np.prod(sizes)) not in (3, 6):
        raise InputError("neither 3 forces nor 3 forces and 3 torques")
    numbers = np.frombuffer(content[2 + 2 * n_dims :], ARRAY_TYPES[kind])
    if len(numbers) != int(np.prod(sizes)):
        raise InputError("body of another size")
    return numbers.astype(np.float64)


def _tracked(body: bytes) -> Iterator[tuple[str, Array]]:
    """Name and pose (4, 4) of every tool of a TDATA message."""
    for name, _, _, pose in TOOL.iter_unpack(body):
        yield _text(name), _pose(pose)


def _alone(read: Callable[[bytes], Array]) -> Callable[[bytes], Named]:
    """A reader of one pose or reading, which has its device's name."""
    return lambda content: [("", read(content))]


#: Element of a TDATA message: name, type, reserved, a pose column by column
TOOL = struct.Struct(">20sBB48s")

#: Numbers of an NDARRAY message, by their type
ARRAY_TYPES = {
    **{2: ">i1", 3: ">u1", 4: ">i2", 5: ">u2", 6: ">i4", 7: ">u4"},
    **{10: ">f4", 11: ">f8"},
}

#: Readers of the types that are wanted
READ: dict[str, Callable[[bytes], Named]] = {
    "TRANSFORM": _alone(_pose),
    "POSITION": _alone(_position),
    "TDATA": _tracked,
    "SENSOR": _alone(_readings),
    "NDARRAY": _alone(_array),
}

#: Types that hold poses, the tools of TDATA included, and those that hold readings
POSES, READINGS = ("TRANSFORM", "POSITION", "TDATA"), ("SENSOR", "NDARRAY")


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
