"""The envelope is checked before the body is looked at."""

import struct
import zlib

import pytest

from tests.message.sealing import sealed
from tests.refusals import refuses
from ttus_opt.core.errors import InputError
from ttus_opt.message.envelope import LONGEST, SURFACE, VERSION, Reader, Writer


def message():
    writer = Writer()
    writer.number("Hd", 7, 0.5)
    writer.packed(b"word" * 100)
    return writer.message(SURFACE)


def test_there_and_back():
    reader = Reader(message())
    assert reader.numbers("Hd") == (7, 0.5)
    assert reader.unpacked(400) == b"word" * 100
    reader.end()
    assert reader.name == zlib.crc32(message()[:-4])


def test_every_byte_counts():
    sound = message()
    for at in range(len(sound)):
        for bit in range(8):
            broken = bytearray(sound)
            broken[at] ^= 1 << bit
            refuses(InputError, "", Reader, bytes(broken))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (b"", "0 bytes are not a message"),
        (b"CDF\x01" * 10, "begins with TTUM"),
        (message()[:-1], "header says"),
        (message() + b"x", "header says"),
        (sealed(b"", SURFACE, VERSION + 1), "update ttus_opt"),
        (sealed(b"", SURFACE, 0), "encode it again"),
        (sealed(b"", 99), "unknown kind 99"),
        (b"TTUM" + struct.pack("<BBI", VERSION, 1, 2**32 - 1) + bytes(20), "at most"),
        ("TTUM", "bytes, got str"),
    ],
)
def test_what_is_no_message_is_named(wrong, words):
    refuses(InputError, words, Reader, wrong)


def test_a_body_that_ends_early_or_late():
    refuses(InputError, "ends early", Reader(sealed(b"abc", SURFACE)).number, "d")
    with pytest.raises(InputError, match="ends early"):
        Reader(sealed(struct.pack("<I", 2**32 - 1), SURFACE)).block()
    refuses(InputError, "3 bytes too many", Reader(sealed(b"abc", SURFACE)).end)


def test_a_packed_part_does_not_grow_beyond_what_is_expected():
    writer = Writer()
    writer.packed(bytes(10_000_000))
    with pytest.raises(InputError, match="the wrong length"):
        Reader(writer.message(SURFACE)).unpacked(1000)
    writer = Writer()
    writer.block(b"no zlib")
    refuses(InputError, "damaged", Reader(writer.message(SURFACE)).unpacked, 1000)


def test_a_message_longer_than_any_reader_takes_is_not_written():
    writer = Writer()
    writer.block(bytes(LONGEST))
    refuses(InputError, "larger max_error", writer.message, SURFACE)
