"""The Point Cloud Data (PCD) format: header, ascii, binary and LZF-compressed.

Only the coordinates are read; every other field is skipped. The layout is that of
the Point Cloud Library's documentation of the format, version 0.7:
``binary`` stores one record per point, ``binary_compressed`` two little-endian
uint32 sizes and then the fields one after the other, LZF-packed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError

#: numpy's kind of a PCD TYPE letter.
_KINDS = {"F": "f", "I": "i", "U": "u"}

#: Most values of one field of a point
MOST_VALUES = 2**16


@dataclass(frozen=True)
class _Header:
    """The text part of a PCD file."""

    fields: tuple[str, ...]
    types: tuple[str, ...]  # numpy codes, little-endian
    counts: tuple[int, ...]
    n_points: int
    encoding: str
    body: bytes

    @property
    def sizes(self) -> list[int]:
        """Bytes of every field of a point."""
        pairs = zip(self.types, self.counts, strict=True)
        return [np.dtype(code).itemsize * count for code, count in pairs]

    @property
    def xyz(self) -> list[int]:
        """Places of x, y and z among the fields."""
        return [self.fields.index(name) for name in "xyz"]

    def points(self, raw: bytes, *, by_field: bool) -> Array:
        """Coordinates of packed records, or of fields one after the other, (n, 3)."""
        sizes, n = np.array(self.sizes), self.n_points
        if not n:  # there are no bytes to begin in
            return np.empty((0, 3))
        begins = (np.cumsum(sizes) - sizes) * (n if by_field else 1)
        step = sizes if by_field else np.full_like(sizes, sizes.sum())
        return np.stack(
            [
                np.ndarray((n,), self.types[m], raw, int(begins[m]), (int(step[m]),))
                for m in self.xyz
            ],
            axis=1,
        ).astype(np.float64)


def read_pcd(path: Path) -> Array:
    """Coordinates of a PCD file, in the file's own unit and order.

    Args:
        path: The file, known to exist.

    Returns:
        Points, shape (n, 3) [the file's unit]; NaN where the camera saw nothing.

    Raises:
        FileError: Not a PCD file, an unknown encoding, or fewer points than the
            header announces.
    """
    header = _read_header(path)
    if header.encoding == "ascii":
        return _ascii(header, path)
    if header.encoding == "binary_compressed":
        return _compressed(header, path)
    available = len(header.body) // sum(header.sizes)
    if available < header.n_points:
        raise truncated(path, header.n_points, available)
    return header.points(header.body, by_field=False)


def _entries(path: Path, raw: bytes) -> tuple[dict[str, list[str]], int]:
    """Words of the header's lines by the first word, and the offset of the data."""
    entries: dict[str, list[str]] = {}
    start = 0
    while "DATA" not in entries:
        end = raw.find(b"\n", start)
        if end < 0 or end - start > 10_000:
            raise FileError(f"{path} has no PCD header (no DATA line): not a PCD file?")
        words = raw[start:end].decode("latin-1").split()
        start = end + 1
        if words and not words[0].startswith("#"):
            entries[words[0].upper()] = words[1:]
    return entries, start


def _read_header(path: Path) -> _Header:
    raw = path.read_bytes()
    entries, start = _entries(path, raw)
    try:
        fields = tuple(entries["FIELDS"])
        sizes = [int(size) for size in entries["SIZE"]]
        kinds = [_KINDS[letter.upper()] for letter in entries["TYPE"]]
        counts = tuple(int(c) for c in entries.get("COUNT", ["1"] * len(fields)))
        if "POINTS" in entries:
            n_points = int(entries["POINTS"][0])
        else:
            n_points = int(entries["WIDTH"][0]) * int(entries["HEIGHT"][0])
        encoding = entries["DATA"][0].lower()
        types = tuple(
            np.dtype(f"<{kind}{size}").str
            for kind, size in zip(kinds, sizes, strict=True)
        )
        if not len(fields) == len(types) == len(counts) or n_points < 0:
            raise ValueError("field counts disagree")
        if not all(0 < count <= MOST_VALUES for count in counts):
            raise ValueError(f"COUNT must be 1 to {MOST_VALUES}")
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise FileError(
            f"{path} has a damaged PCD header ({type(error).__name__}: {error}): "
            "export it again"
        ) from error
    if n_points > len(raw):  # before anything of that size is made
        raise truncated(path, n_points, 0)
    if not {"x", "y", "z"} <= set(fields):
        raise FileError(
            f"{path} has the fields {' '.join(fields)}, expected x, y and z among them"
        )
    if encoding not in ("ascii", "binary", "binary_compressed"):
        raise FileError(
            f"{path} has PCD data of kind {encoding!r}, expected ascii, binary or "
            "binary_compressed: export it again"
        )
    return _Header(fields, types, counts, n_points, encoding, raw[start:])


def truncated(path: Path, expected: int, found: int) -> FileError:
    """The error for a file that holds fewer points than its header announces."""
    return FileError(
        f"{path} is truncated: its header announces {expected} points, it holds "
        f"{found}: record or copy it again"
    )


def _ascii(header: _Header, path: Path) -> Array:
    lines = [line for line in header.body.decode("latin-1").splitlines() if line]
    if len(lines) < header.n_points:
        raise truncated(path, header.n_points, len(lines))
    ends = np.cumsum(header.counts)
    columns = [int(ends[m]) - header.counts[m] for m in header.xyz]
    points = np.empty((header.n_points, 3))
    for row, line in enumerate(lines[: header.n_points]):
        words = line.split()
        if len(words) != ends[-1]:
            raise FileError(
                f"{path}: point {row + 1} has {len(words)} values, expected "
                f"{ends[-1]}: truncated or damaged, export it again"
            )
        try:
            points[row] = [float(words[c]) for c in columns]
        except ValueError as error:
            raise FileError(
                f"{path}: point {row + 1} is not a number ({error}): export it again"
            ) from error
    return points


def _compressed(header: _Header, path: Path) -> Array:
    if len(header.body) < 8:
        raise truncated(path, header.n_points, 0)
    packed_size, size = np.frombuffer(header.body, "<u4", 2).tolist()
    packed = header.body[8 : 8 + packed_size]
    expected = header.n_points * sum(header.sizes)
    if size != expected:
        raise FileError(
            f"{path} unpacks to {size} bytes, expected {expected}: damaged, export it "
            "again"
        )
    if len(packed) < packed_size:
        raise FileError(
            f"{path} is truncated: {packed_size} packed bytes announced, it holds "
            f"{len(packed)}: record or copy it again"
        )
    try:
        raw = lzf_decompress(packed, size)
    except (IndexError, ValueError) as error:
        raise FileError(
            f"{path} cannot be unpacked ({error}): damaged, export it again"
        ) from error
    return header.points(raw, by_field=True)


def lzf_decompress(packed: bytes, size: int) -> bytes:
    """Unpack an LZF block.

    A control byte below 32 announces that many + 1 literal bytes; any other holds
    the length (upper 3 bits, 7 meaning "see the next byte") and, with the byte
    after it, the distance of a repetition of what was already unpacked.

    Args:
        packed: The packed bytes.
        size: Number of bytes it must unpack to.

    Returns:
        The unpacked bytes.

    Raises:
        ValueError: It unpacks to another size or refers to before its beginning.
    """
    out = bytearray()
    at, end = 0, len(packed)
    while at < end:
        control = packed[at]
        at += 1
        if control < 32:
            out += packed[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += packed[at]
            at += 1
        distance = ((control & 31) << 8) + packed[at] + 1
        at += 1
        length += 2
        start = len(out) - distance
        if start < 0:
            raise ValueError("a repetition reaches before the beginning")
        # A repetition may overlap itself: repeat its period, then cut.
        piece = bytes(out[start : start + min(length, distance)])
        out += (piece * math.ceil(length / len(piece)))[:length]
        if len(out) > size:
            break
    if len(out) != size:
        raise ValueError(f"{len(out)} bytes unpacked, expected {size}")
    return bytes(out)
