"""The envelope of every message: mark, version, kind, length, checksum.

    mark "TTUM" | version u8 | kind u8 | length u32 | body | CRC-32 u32

Numbers are little-endian; the length counts all bytes. The checksum covers everything
before it. It is also the message's name, by which others refer to it.

Whole numbers are written by pcodec, dense or sparse, whichever is shorter. The receiver
knows their count in advance and decodes into an array of that length;
anything that does not fill it exactly is damaged.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core import io
from ttus_opt.core.arrays import IntArray
from ttus_opt.core.errors import FileError, InputError
from ttus_opt.core.optional import load

MARK: Final = b"TTUM"
VERSION: Final = 3

SURFACE, SURFACE_DELTA, FIELD = 1, 2, 3

#: Names of the kinds, for errors
NAMES = {SURFACE: "surface", SURFACE_DELTA: "change of a surface", FIELD: "field"}

HEAD = struct.Struct("<4sBBI")
CHECKSUM = struct.Struct("<I")

#: Longest message [bytes]; the largest surface fits
LONGEST = 2**24


class Writer:
    """The body of a message, item by item."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []

    def number(self, layout: str, *values: float) -> None:
        """Append numbers in a `struct` layout."""
        self._parts.append(struct.pack(f"<{layout}", *values))

    def block(self, content: bytes) -> None:
        """Append bytes, preceded by their count."""
        self.number("I", len(content))
        self._parts.append(content)

    def packed(self, content: bytes) -> None:
        """Append bytes, compressed by zlib."""
        self.block(zlib.compress(content, 9))

    def message(self, kind: int) -> bytes:
        """The body in its envelope."""
        body = b"".join(self._parts)
        length = HEAD.size + len(body) + CHECKSUM.size
        if length > LONGEST:
            raise InputError(
                f"the message would take {length:,} bytes, more than {LONGEST:,}: "
                "choose a larger max_error or a coarser grid"
            )
        sealed = HEAD.pack(MARK, VERSION, kind, length) + body
        return sealed + CHECKSUM.pack(zlib.crc32(sealed))


class Reader:
    """A received message, its envelope checked before anything is read.

    Raises:
        InputError: Not a message, another version, truncated, too long, or damaged.
    """

    def __init__(self, message: bytes) -> None:
        if not isinstance(message, bytes | bytearray | memoryview):
            raise InputError(f"a message must be bytes, got {type(message).__name__}")
        size = len(message)
        if size < HEAD.size + CHECKSUM.size or bytes(message[:4]) != MARK:
            raise InputError(
                f"these {size} bytes are not a message of ttus_opt, which begins with "
                f"{MARK.decode()}: wrong file?"
            )
        _, version, self.kind, length = HEAD.unpack_from(message)
        if version != VERSION:
            newer = version > VERSION
            raise InputError(
                f"the message has version {version}, this ttus_opt reads version "
                f"{VERSION}: {'update ttus_opt' if newer else 'encode it again'}"
            )
        if length != size or size > LONGEST:
            raise InputError(
                f"the message has {size:,} bytes, its header says {length:,} and at "
                f"most {LONGEST:,} are read: ask for it again"
            )
        self._content = bytes(message)
        (self.name,) = CHECKSUM.unpack_from(self._content, size - CHECKSUM.size)
        if zlib.crc32(self._content[: -CHECKSUM.size]) != self.name:
            raise InputError(
                "the message is damaged: its checksum is wrong: ask for it again"
            )
        self._at, self._end = HEAD.size, size - CHECKSUM.size
        if self.kind not in NAMES:
            raise InputError(
                f"the message has the unknown kind {self.kind}: update ttus_opt"
            )

    def _take(self, count: int) -> bytes:
        if count > self._end - self._at:
            raise InputError("the message is damaged: it ends early: ask for it again")
        self._at += count
        return self._content[self._at - count : self._at]

    def numbers(self, layout: str) -> tuple[Any, ...]:
        """The next numbers, in a `struct` layout."""
        form = struct.Struct(f"<{layout}")
        return form.unpack(self._take(form.size))

    def number(self, layout: str) -> Any:
        """The next number."""
        return self.numbers(layout)[0]

    def block(self) -> bytes:
        """The next bytes, preceded by their count."""
        return self._take(self.number("I"))

    def unpacked(self, most: int) -> bytes:
        """The next bytes, decompressed by zlib; more than ``most`` are damage."""
        expand = zlib.decompressobj()
        try:
            content = expand.decompress(self.block(), most)
        except zlib.error as error:
            raise InputError(f"the message is damaged: {error}") from error
        if not expand.eof or expand.unused_data:
            raise InputError("the message is damaged: a part has the wrong length")
        return content

    def end(self) -> None:
        """Check that everything has been read; `InputError` otherwise."""
        if self._at != self._end:
            raise InputError(
                f"the message is damaged: {self._end - self._at} bytes too many"
            )


DENSE, SPARSE = 0, 1

#: Highest compression level of pcodec: the arrays are small
LEVEL = 12

DAMAGED = "the message is damaged: its numbers cannot be decoded: ask for it again"


def write_integers(writer: Writer, values: IntArray) -> None:
    """Append numbers within 32 bits, shape (n,)."""
    at = np.flatnonzero(values)
    gaps = np.diff(at, prepend=-1)
    dense = _compressed(values)
    sparse = (_compressed(gaps), _compressed(values[at])) if len(at) else (b"", b"")
    if len(dense) + 1 <= sum(map(len, sparse)) + 6:
        writer.number("B", DENSE)
        writer.block(dense)
        return
    writer.number("B", SPARSE)
    writer.number("I", len(at))
    for block in sparse:
        writer.block(block)


def read_integers(reader: Reader, count: int) -> IntArray:
    """Numbers that `write_integers` appended, shape (count,).

    Raises:
        InputError: They are damaged or of another count.
        MissingPackageError: pcodec is not installed.
    """
    kind = reader.number("B")
    if kind == DENSE:
        return _expanded(reader.block(), count).astype(np.int64)
    if kind != SPARSE:
        raise InputError(DAMAGED)
    some = reader.number("I")
    if some > count:
        raise InputError(DAMAGED)
    values = np.zeros(count, np.int64)
    gaps, numbers = reader.block(), reader.block()
    if some == 0:
        return values
    steps = _expanded(gaps, some).astype(np.int64)
    at = np.cumsum(steps) - 1
    if (steps < 1).any() or at[-1] >= count:
        raise InputError(DAMAGED)
    values[at] = _expanded(numbers, some)
    return values


def _compressed(values: IntArray) -> bytes:
    pcodec: Any = load("pcodec", "sensors")
    config = pcodec.ChunkConfig(
        compression_level=LEVEL,
        mode_spec=pcodec.ModeSpec.classic(),
        delta_spec=pcodec.DeltaSpec.no_op(),
    )
    numbers = np.ascontiguousarray(values, dtype=np.int32)
    return bytes(pcodec.standalone.simple_compress(numbers, config))


def _expanded(block: bytes, count: int) -> NDArray[np.int32]:
    """Decoded numbers, shape (count,).

    Raises:
        InputError: The block is damaged or holds another count.
    """
    pcodec: Any = load("pcodec", "sensors")
    numbers = np.zeros(count, np.int32)
    try:
        progress = pcodec.standalone.simple_decompress_into(block, numbers)
    except (RuntimeError, TypeError, ValueError) as error:
        raise InputError(DAMAGED) from error
    if progress.n_processed != count or not progress.finished:
        raise InputError(DAMAGED)
    return numbers


def read_message(path: Path) -> tuple[bytes, str]:
    """A file's message, its envelope checked, and the name of its kind.

    Raises:
        FileError: It cannot be read, or is no sound message.
    """
    content = io.existing_file(path, "message", LONGEST).read_bytes()
    if not content.startswith(MARK):
        raise FileError(f"{path} is not a message of ttus_opt: wrong file?")
    try:
        return content, NAMES[Reader(content).kind]
    except InputError as error:
        raise FileError(f"{path}: {error}") from error
