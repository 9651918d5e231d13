"""The envelope is checked before the body is looked at."""

import struct
import zlib

import numpy as np
import pytest

from tests.kit import InputError, MissingPackageError, refuses
from tests.message.sealing import sealed
from ttus_opt.message.envelope import (
    DENSE,
    LONGEST,
    SPARSE,
    SURFACE,
    VERSION,
    Reader,
    Writer,
    read_integers,
    write_integers,
)


@pytest.fixture
def pcodec():
    return pytest.importorskip("pcodec", reason="needs ttus-opt[sensors]")


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


def sparse_numbers():
    """Few of many, in clusters."""
    numbers = np.zeros(50_000, np.int64)
    numbers[7::1000] = numbers[8::1000] = 1
    numbers[[0, 49_999]] = [-(2**31) + 1, 2**31 - 1]
    return numbers


@pytest.mark.usefixtures("pcodec")
@pytest.mark.parametrize(
    ("numbers", "kind"),
    [
        (np.zeros(0, np.int64), None),
        (np.zeros(100_000, np.int64), None),
        (np.arange(-500, 500), DENSE),
        (sparse_numbers(), SPARSE),
    ],
)
def test_integers_go_there_and_back(numbers, kind):
    writer = Writer()
    write_integers(writer, numbers)
    message = writer.message(SURFACE)
    if kind is not None:
        assert message[10] == kind
    reader = Reader(message)
    np.testing.assert_array_equal(read_integers(reader, len(numbers)), numbers)
    reader.end()


@pytest.mark.usefixtures("pcodec")
@pytest.mark.parametrize("count", [999, 1001, 0, 10**6])
def test_another_count_is_refused(count):
    writer = Writer()
    write_integers(writer, np.arange(-500, 500))
    with pytest.raises(InputError, match="damaged"):
        read_integers(Reader(writer.message(SURFACE)), count)


def hostile(gaps, count):
    """A sparse array with these gaps."""
    writer, block = Writer(), Writer()
    for numbers in (gaps, [1] * len(gaps)):
        write_integers(block, np.array(numbers))
    content = block.message(SURFACE)[10:-4]
    first = 5 + int.from_bytes(content[1:5], "little")
    writer.number("BI", SPARSE, count)
    parts = content[1:first], content[first + 1 :]
    return Reader(sealed(b"".join([*writer._parts, *parts]), SURFACE))


@pytest.mark.usefixtures("pcodec")
def test_sound_gaps_are_taken():
    assert read_integers(hostile([1, 2, 1], 3), 9).tolist() == [1, 0, 1, 1] + 5 * [0]


@pytest.mark.usefixtures("pcodec")
@pytest.mark.parametrize("gaps", [[0, 1], [1, -1], [5, 5], [2**31 - 1, 1]])
def test_gaps_that_lead_elsewhere_are_refused(gaps):
    refuses(InputError, "damaged", read_integers, hostile(gaps, 2), 9)


@pytest.mark.usefixtures("pcodec")
def test_more_numbers_than_asked_for_are_refused():
    refuses(InputError, "damaged", read_integers, hostile([1, 1, 1], 3), 2)


def test_without_pcodec_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pcodec", None)
    with pytest.raises(MissingPackageError, match=r"ttus-opt\[sensors\]"):
        write_integers(Writer(), np.arange(4))
