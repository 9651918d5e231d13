"""PCD: fields of other types, counts and paddings; damage told in one line."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.kit import FileError, refuses
from tests.scan.test_cloud import POINTS, lzf_compress, pcd_header
from ttus_opt.scan.pcd import lzf_decompress, read_pcd

#: A 16-bit intensity, doubles, three normals: fields on all sides of x, y, z
MIXED = (
    "FIELDS intensity x y normal z\nSIZE 2 8 8 4 8\nTYPE U F F F F\n"
    "COUNT 1 1 1 3 1\nWIDTH 20\nHEIGHT 10\nDATA {}\n"
)
RECORD = np.dtype(
    [("i", "<u2"), ("x", "<f8"), ("y", "<f8"), ("n", "<f4", 3), ("z", "<f8")]
)


def mixed():
    table = np.zeros(len(POINTS), RECORD)
    table["i"], table["n"] = np.arange(len(POINTS)), 7.0
    for column, name in enumerate("xyz"):
        table[name] = POINTS[:, column]
    return table


def body(encoding):
    """The points of `mixed`, written one way or another."""
    table = mixed()
    if encoding == "binary":
        return table.tobytes()
    if encoding == "ascii":
        rows = (np.concatenate([np.atleast_1d(v) for v in row]) for row in table)
        return "\n".join(" ".join(f"{v:.17g}" for v in row) for row in rows).encode()
    raw = b"".join(table[name].tobytes() for name in RECORD.names or ())
    packed = lzf_compress(raw)
    return np.array([len(packed), len(raw)], "<u4").tobytes() + packed


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_other_fields_are_stepped_over(encoding, tmp_path):
    path = tmp_path / "c.pcd"
    path.write_bytes(MIXED.format(encoding).encode() + body(encoding))
    np.testing.assert_array_equal(read_pcd(path), POINTS.astype(float))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("TYPE F F F", "TYPE F F Q"), "damaged PCD header"),
        (("SIZE 4 4 4", "SIZE 4 4"), "damaged PCD header"),
        (("DATA binary\n", ""), "no DATA line"),
    ],
)
def test_headers_that_cannot_be_meant(change, told, tmp_path):
    path = tmp_path / "c.pcd"
    header = pcd_header(len(POINTS), "binary", fields="x y z").replace(*change)
    path.write_bytes(header.encode() + POINTS.tobytes())
    refuses(FileError, told, read_pcd, path)


@given(st.binary(max_size=400).map(lambda b: b * 3) | st.binary(max_size=2000))
def test_lzf_round_trip(raw):
    assert lzf_decompress(lzf_compress(raw), len(raw)) == raw


def test_lzf_overlapping_repetition():
    # two literals "ab", then 7 bytes from 2 back: their own output is repeated
    assert lzf_decompress(bytes([1, 97, 98, 5 << 5, 1]), 9) == b"ababababa"
    with pytest.raises(ValueError, match="before the beginning"):
        lzf_decompress(bytes([0, 97, 1 << 5, 5]), 4)
    refuses(ValueError, "expected 5", lzf_decompress, bytes([1, 97, 98]), 5)
