"""Messages of a live session: their fields, limits, sequence and checksum.

A packet is a msgpack array and its CRC-32. Every packet tells who sent it (an epoch,
another one at every start of that side), its number, the sender's clock, what it last
heard, and its state of safety: a lost packet loses nothing but its body. Poses and
wrenches are float32. `decode` refuses what is damaged, too long, of another version or
not finite: msgspec checks types and ranges, but lets NaN pass.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass, field
from typing import Annotated, Final

import msgspec
import numpy as np

from ttus_opt import message
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.message.envelope import SURFACE, Reader
from ttus_opt.probe.pose import from_quaternions, to_quaternions
from ttus_opt.scan.surface import Surface

#: Of what a law means: since 3 depths count by the slope of the skin, since 2 it is
#: sampled by contact size, in 1 trilinearly
VERSION: Final = 3

#: Longest datagram and longest message of the stream [bytes]: no fragments on any
#: network; a surface of 720 x 600 radii
LONGEST_DATAGRAM, LONGEST = 1200, 2**18

#: Ticks of a clock [1/s]: 10 µs, eleven hours in 32 bits
TICKS = 100_000
MOST_TICKS = 2**32

#: Numbers of a sample: its age, position, quaternion w x y z, force, torque
SAMPLE = 14

#: Most samples in a packet; longest text
MOST_SAMPLES, LONGEST_TEXT = 4, 120

#: Largest position [m], force [N] and torque [N m]: beyond, something is in other units
FARTHEST, STRONGEST = 10.0, 1000.0

_CHECKSUM = struct.Struct("<I")

#: 32 bits; a text of a message
Bits = Annotated[int, msgspec.Meta(ge=0, lt=MOST_TICKS)]
Words = Annotated[str, msgspec.Meta(max_length=LONGEST_TEXT)]


class MessageError(InputError):
    """A packet that is not one of this version, or with values out of range."""


class DamagedError(MessageError):
    """A packet with a wrong checksum."""


class NotFiniteError(MessageError):
    """A packet with NaN or infinity, intact otherwise."""


class Hello(msgspec.Struct, tag=1, array_like=True, frozen=True):
    """Who joins, and with what; an operator repeats it until the follower obeys.

    Attributes:
        version: `VERSION`.
        model: CRC-32 of the last model's message that it took, 0 for none.
        units: Always SI.
    """

    version: int
    model: int = 0
    units: Words = "SI"


class PoseCommand(msgspec.Struct, tag=2, array_like=True, frozen=True):
    """The probe in the operator's hand: 7 float32, position and quaternion w x y z."""

    pose: bytes


class Measurement(msgspec.Struct, tag=3, array_like=True, frozen=True):
    """The last samples, newest first.

    Attributes:
        index: Number of the newest.
        samples: `SAMPLE` float32 of each.
    """

    index: Bits
    samples: bytes


class SurfaceMessage(msgspec.Struct, tag=4, array_like=True, frozen=True):
    """A surface, or a change of it, as `ttus_opt.message` encodes it."""

    content: bytes


class ModelMessage(msgspec.Struct, tag=5, array_like=True, frozen=True):
    """A whole model over the last surface, of `ttus_opt.live.model`."""

    content: bytes


class StateReport(msgspec.Struct, tag=7, array_like=True, frozen=True):
    """Only the header, which has the state: a sign of life."""


class Stop(msgspec.Struct, tag=8, array_like=True, frozen=True):
    """Stop, and why."""

    cause: Words


Body = (
    Hello
    | PoseCommand
    | Measurement
    | SurfaceMessage
    | ModelMessage
    | StateReport
    | Stop
)


class Packet(msgspec.Struct, array_like=True, frozen=True):
    """A body and its header.

    Attributes:
        epoch: Which process sent it, such as the second of its start, 32 bits.
        sequence: Its number, from 1.
        sent: Sender's clock [ticks].
        echo: Receiver's clock in the last packet heard [ticks].
        held: How long ago that was heard [ticks]; 0 with no ``echo`` yet.
        state: `safety.State` of the sender.
        stops: Number of its stops so far.
        body: The content.
    """

    epoch: Bits
    sequence: Bits
    sent: Bits
    echo: Bits
    held: Bits
    state: Annotated[int, msgspec.Meta(ge=0, le=2)]
    stops: Bits
    body: Body


@dataclass(frozen=True)
class Sample:
    """A pose of the probe and what it felt.

    Attributes:
        time: By the follower's clock [s].
        rotation: Probe to patient, shape (3, 3) [–].
        position: Origin of the probe frame, patient frame, shape (3,) [m].
        wrench: Force, then torque on the probe, patient axes, shape (6,) [N, N·m].
    """

    time: float
    rotation: Array = field(repr=False)
    position: Array
    wrench: Array


def encode(packet: Packet) -> bytes:
    """A packet as bytes."""
    content = msgspec.msgpack.encode(packet)
    return content + _CHECKSUM.pack(zlib.crc32(content))


_DECODER = msgspec.msgpack.Decoder(Packet)


def decode(data: bytes, longest: int = LONGEST) -> Packet:
    """A packet from bytes that anyone may have sent.

    Raises:
        DamagedError: A wrong checksum.
        NotFiniteError: NaN or infinity.
        MessageError: Too long, not a packet, or a value out of range.
    """
    if not _CHECKSUM.size < len(data) <= longest:
        raise MessageError(f"a packet has at most {longest} bytes, got {len(data)}")
    content = data[: -_CHECKSUM.size]
    if zlib.crc32(content) != _CHECKSUM.unpack(data[-_CHECKSUM.size :])[0]:
        raise DamagedError("the packet's checksum is wrong")
    try:
        packet = _DECODER.decode(content)
    except (msgspec.DecodeError, RecursionError) as error:
        raise MessageError(f"not a packet of version {VERSION}: {error}") from error
    match packet.body:
        case PoseCommand() as body:
            pose_of(body)
        case Measurement() as body:
            samples_of(body, 0.0)
        case Hello(units=text) | Stop(cause=text) if not text.isprintable():
            raise MessageError("a text has printable characters only")
        case _:
            pass
    return packet


def decoded_surface(content: bytes, whole: bytes | None) -> tuple[Surface, bool]:
    """The surface of a `SurfaceMessage`, and whether it came whole.

    Args:
        content: A whole surface, or a change of one.
        whole: The last that came whole; None before it.

    Raises:
        InputError: It is damaged, no surface, or a change of another one.
    """
    is_whole = Reader(content).kind == SURFACE
    surface = message.decode(content, base=None if is_whole else whole)
    if not isinstance(surface, Surface):
        raise InputError("a surface was announced, but a field came")
    return surface, is_whole


def pose_command(rotation: Array, position: Array) -> PoseCommand:
    """A pose (3, 3), (3,) [m] as a command."""
    numbers = np.concatenate([position, to_quaternions(rotation[None])[0]])
    return PoseCommand(numbers.astype("<f4").tobytes())


def pose_of(command: PoseCommand) -> tuple[Array, Array]:
    """Rotation (3, 3) and position (3,) [m] of a command.

    Raises:
        NotFiniteError: NaN or infinity.
        MessageError: Another size, too far away, or no rotation.
    """
    row = _floats(command.pose, 7)
    return _rotations(row[None])[0], row[:3].copy()


def measurement(index: int, samples: list[Sample], now: float) -> Measurement:
    """Samples, newest first, as a message."""
    quaternions = to_quaternions(np.array([s.rotation for s in samples]))
    rows = [
        np.concatenate([[now - s.time], s.position, q, s.wrench])
        for s, q in zip(samples, quaternions, strict=True)
    ]
    return Measurement(index, np.array(rows).astype("<f4").tobytes())


def samples_of(message: Measurement, sent: float) -> list[Sample]:
    """Samples of a message sent at some time by the follower's clock, newest first.

    Raises:
        NotFiniteError: NaN or infinity.
        MessageError: Another size, or a value out of range.
    """
    count, rest = divmod(len(message.samples), 4 * SAMPLE)
    if rest or not 1 <= count <= MOST_SAMPLES:
        raise MessageError(f"a measurement of {len(message.samples)} bytes")
    rows = _floats(message.samples, SAMPLE * count).reshape(count, SAMPLE)
    age, place, wrench = rows[:, 0], rows[:, 1:4], rows[:, 8:]
    if np.abs(wrench).max() > STRONGEST or age.min() < -1.0 or age.max() > 1e4:
        raise MessageError("a wrench or an age is out of range: other units?")
    turns = _rotations(rows[:, 1:8])
    return [
        Sample(sent - float(age[k]), turns[k], place[k].copy(), wrench[k].copy())
        for k in range(count)
    ]


def _floats(content: bytes, count: int) -> Array:
    if len(content) != 4 * count:
        raise MessageError(f"expected {count} float32, got {len(content)} bytes")
    values = np.frombuffer(content, dtype="<f4").astype(np.float64)
    if not math.isfinite(float(values @ values)):
        raise NotFiniteError("a pose or a wrench contains NaN or infinity")
    return values


def _rotations(rows: Array) -> Array:
    """Rotations (k, 3, 3) of positions and quaternions, shape (k, 7), once checked."""
    if np.abs(rows[:, :3]).max() > FARTHEST:
        raise MessageError(f"a position is beyond {FARTHEST:g} m: other units?")
    length = np.sqrt((rows[:, 3:] ** 2).sum(axis=1))
    worst = float(length[np.abs(length - 1.0).argmax()])
    if abs(worst - 1.0) > 1e-3:
        raise MessageError(f"a quaternion has length {worst:.3g}, not 1")
    return from_quaternions(rows[:, 3:] / length[:, None], "wxyz")
