"""Whole numbers there and back, dense and sparse; damage is told."""

import numpy as np
import pytest

from tests.message.sealing import sealed
from tests.refusals import refuses
from ttus_opt.core.errors import InputError, MissingPackageError
from ttus_opt.message.envelope import SURFACE, Reader, Writer
from ttus_opt.message.integer_stream import DENSE, SPARSE, read_integers, write_integers

pytest.importorskip("pcodec", reason="needs ttus-opt[sensors]")


def sparse_numbers():
    """Few of many, in clusters."""
    numbers = np.zeros(50_000, np.int64)
    numbers[7::1000] = numbers[8::1000] = 1
    numbers[[0, 49_999]] = [-(2**31) + 1, 2**31 - 1]
    return numbers


@pytest.mark.parametrize(
    ("numbers", "kind"),
    [
        (np.zeros(0, np.int64), None),
        (np.zeros(100_000, np.int64), None),
        (np.arange(-500, 500), DENSE),
        (sparse_numbers(), SPARSE),
    ],
)
def test_there_and_back(numbers, kind):
    writer = Writer()
    write_integers(writer, numbers)
    message = writer.message(SURFACE)
    if kind is not None:
        assert message[10] == kind
    reader = Reader(message)
    np.testing.assert_array_equal(read_integers(reader, len(numbers)), numbers)
    reader.end()


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


def test_sound_gaps_are_taken():
    assert read_integers(hostile([1, 2, 1], 3), 9).tolist() == [1, 0, 1, 1] + 5 * [0]


@pytest.mark.parametrize("gaps", [[0, 1], [1, -1], [5, 5], [2**31 - 1, 1]])
def test_gaps_that_lead_elsewhere_are_refused(gaps):
    refuses(InputError, "damaged", read_integers, hostile(gaps, 2), 9)


def test_more_numbers_than_asked_for_are_refused():
    refuses(InputError, "damaged", read_integers, hostile([1, 1, 1], 3), 2)


def test_without_pcodec_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pcodec", None)
    with pytest.raises(MissingPackageError, match=r"ttus-opt\[sensors\]"):
        write_integers(Writer(), np.arange(4))
