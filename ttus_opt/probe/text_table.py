"""Tables of numbers as text: separators, comments and column names of other programs.

A header names the columns, in any case and as other programs do
(`ttus_opt.probe.column_names`), with units in brackets where it states them. Comment
lines (``#``, ``%``, ``//``) and other text may precede it; the header may itself be a
comment, and a line of units may follow it. Cells are separated by commas, semicolons,
tabs or blanks.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError, InputError
from ttus_opt.probe.column_names import ROTATION_VECTOR, Header, any_unit, named_columns
from ttus_opt.probe.pose import QUATERNION_TOLERANCE

#: Marks of a comment line
COMMENT = re.compile(r"^\s*(#|%|//)+\s*")

#: Time stamps above this are in nanoseconds, as ROS writes integers [s]
NANOSECONDS = 1e14

#: Longest part of a header that an error shows [characters]
LONGEST_HEADER = 200

#: Most lines of text before a header
MOST_PREAMBLE = 60

#: A pose without a header, as TUM's benchmark writes it
TUM = ("t", "px", "py", "pz", "qx", "qy", "qz", "qw")


class MissingColumnsError(FileError):
    """A header that lacks columns.

    Attributes:
        missing: Their names.
    """

    def __init__(
        self, file: Path, required: Sequence[str], missing: Sequence[str], got: str
    ) -> None:
        self.missing, self._got, self._required = missing, got, ",".join(required)
        self._share = len(missing) / len(required)
        super().__init__(self._told(file, self._required))
        self._file = file

    def _told(self, file: Path, names: str) -> str:
        if not self._got:
            return f"{file} has no header: write {names} as its first line"
        return (
            f"{file} has no column {', '.join(self.missing)}: the header must name "
            f"{names}, got {self._got}; map them by columns, for "
            f"instance {self.missing[0]}=NAME"
        )

    def nearly(self) -> list[str]:
        """What to say where half of the columns are there: likely a mistake."""
        return [f"no {', '.join(self.missing)}: no poses"] if self._share < 0.5 else []

    def either(self, other: MissingColumnsError) -> FileError:
        """Of two readings of one file, told by the one that lacks least."""
        nearer = min(self, other, key=lambda error: error._share)
        names = f"{self._required} (poses) or {other._required} (wrenches)"
        return FileError(nearer._told(self._file, names))


@dataclass(frozen=True)
class TextTable:
    """Cells of a file, not yet read as numbers.

    Attributes:
        file: Their source.
        header: Its columns, by the package's names where known.
        cells: One list per row, all of the same length.
        line: Line number of each row, from 1, shape (T,).
        damaged: What is wrong with a row that had another number of cells, by row.
        preamble: Lines before the header.
    """

    file: Path
    header: Header
    cells: list[list[str]] = field(repr=False)
    line: NDArray[np.int64] = field(repr=False)
    damaged: Mapping[int, str] = field(repr=False)
    preamble: tuple[str, ...] = ()

    @property
    def names(self) -> list[str]:
        """Names of the columns, and of those that are sums of several."""
        return [*self.header.names, *self.header.sums]

    def readable(self, wanted: Sequence[str]) -> tuple[Array, dict[int, str]]:
        """Some columns in SI units, (T, len(wanted)), NaN for what is not a number.

        Also why it is none, by row.

        Raises:
            FileError: A wanted column has an unknown unit.
        """
        out = np.zeros((len(self.cells), len(wanted)))
        unread: dict[int, str] = {}
        for place, name in enumerate(wanted):
            for index, scale in self._terms(name):
                column = self._column(index, name, unread)
                out[:, place] += column * scale
        unread.update(self.damaged)
        out[list(self.damaged)] = np.nan
        return out, unread

    def _terms(self, name: str) -> list[tuple[int, float]]:
        """Index and factor to SI of the columns whose sum a column is."""
        terms = self.header.sums.get(name) or [self.header.names.index(name)]
        for index in terms:
            if fault := self.header.faults.get(index):
                raise FileError(f"{self.file}: {fault}")
        return [(index, self.header.scale[index]) for index in terms]

    def _column(self, index: int, name: str, unread: dict[int, str]) -> Array:
        cells = [row[index] for row in self.cells]
        try:
            return np.array(cells, dtype=np.float64)
        except ValueError:
            return np.array(
                [self._cell(i, c, name, unread) for i, c in enumerate(cells)]
            )

    def _cell(self, row: int, cell: str, name: str, unread: dict[int, str]) -> float:
        try:
            return float(cell)
        except ValueError:
            found = f"{io.shortened(cell)}, not a number" if cell else "empty"
            comma = ", with a decimal comma? write a point" if "," in cell else ""
            unread.setdefault(row, f"{name} is {found}{comma}")
            return np.nan


def read_text_table(
    file: Path, required: Sequence[str], columns: Mapping[str, str] | None = None
) -> TextTable:
    """Read a table whose header names the required columns.

    Args:
        file: The file.
        required: Columns that must exist, by the package's names.
        columns: The file's names of columns, by the package's: with a unit behind it in
            brackets where the file states none (``tip_x[mm]``), and two to be added
            (``sec+nanosec[ns]``).

    Raises:
        FileError: Not text, no such header, or no rows.
        InputError: ``columns`` names a column that does not exist.
    """
    lines = io.read_text(file).splitlines()
    head, separator, given = _header(file, lines, required, columns or {})
    numbered = [
        (number, _split(line, separator))
        for number, line in enumerate(lines[head + 1 :], start=head + 2)
        if line.strip() and not COMMENT.match(line)
    ]
    if (
        numbered
        and any(cells := numbered[0][1])
        and all(map(any_unit, filter(None, cells)))
    ):
        units = numbered.pop(0)[1]
        given = [
            f"{name} [{unit}]" if unit else name
            for name, unit in zip(given, [*units, *[""] * len(given)], strict=False)
        ]
    if not numbered:
        raise FileError(
            f"{file} is empty, it has a header and no rows: record or export it again"
        )
    header = TUM_HEADER if head < 0 else named_columns(given, columns or {}, required)
    rows = [cells for _, cells in numbered]
    damaged = _even(rows, len(header.names))
    line = np.array([number for number, _ in numbered], dtype=np.int64)
    return TextTable(file, header, rows, line, damaged, tuple(lines[: max(head, 0)]))


TUM_HEADER = named_columns(TUM, {}, TUM).noted(
    "no header: read as t px py pz qx qy qz qw, as TUM's benchmark has it"
)


def seconds(time: Array) -> Array:
    """Times of a table [s], whole nanoseconds of ROS converted to a quarter of a µs.

    Stamps keep their origin: streams of one clock stay on one clock.
    """
    known = time[np.isfinite(time)]
    return 1e-9 * time if len(known) and known.min() > NANOSECONDS else time


def _even(rows: list[list[str]], n: int) -> dict[int, str]:
    """Make all rows as long as the header; what was wrong with the others, by row."""
    damaged = {}
    for place, row in enumerate(rows):
        if len(row) != n:
            why = ": decimal commas? write points" if len(row) > n else ""
            if place == len(rows) - 1 and len(row) < n:
                why = ": the file is truncated"
            damaged[place] = f"{len(row)} cells, the header has {n}{why}"
            rows[place] = [*row, *[""] * n][:n]
    return damaged


def _header(
    file: Path,
    lines: Sequence[str],
    required: Sequence[str],
    columns: Mapping[str, str],
) -> tuple[int, str | None, list[str]]:
    """The header's line index (-1 for none), the separator and its words."""
    closest: list[str] = []
    missing = list(required)
    passed = 0
    for place, line in enumerate(lines):
        if not line.strip():
            continue
        text = COMMENT.sub("", line)
        separator = separator_of(text)
        given = _split(text, separator)
        found = named_columns(given, columns, required)
        lacking = _lacking(required, [*found.names, *found.sums])
        if not lacking:
            _refuse_absent(given, found)
            return place, separator, given
        if COMMENT.match(line):
            continue
        if "qw" in required and not passed and _is_pose(given):
            return -1, separator, list(TUM)
        if not closest or len(lacking) < len(missing):
            closest, missing = [*found.names, *found.sums], lacking
        passed += 1
        if passed > MOST_PREAMBLE:
            break
    shown = "" if are_numbers(closest) else ",".join(closest) or "none"
    if len(shown) > LONGEST_HEADER:
        shown = f"{shown[:LONGEST_HEADER]}… ({len(closest):,} in all)"
    raise MissingColumnsError(file, required, missing, shown)


def _lacking(required: Sequence[str], names: Sequence[str]) -> list[str]:
    """Required names that are not there; a rotation vector stands for a quaternion."""
    turned = all(name in names for name in ROTATION_VECTOR)
    return [n for n in required if n not in names and not (turned and n[0] == "q")]


def are_numbers(cells: Sequence[str]) -> bool:
    """Whether a line has numbers, and nothing else."""
    try:
        return len([float(cell) for cell in cells]) > 0
    except ValueError:
        return False


def _is_pose(cells: Sequence[str]) -> bool:
    """Whether a line is a time, a position and a unit quaternion."""
    if len(cells) != len(TUM) or not are_numbers(cells):
        return False
    length = float(np.linalg.norm([float(cell) for cell in cells[4:]]))
    return abs(length - 1.0) < QUATERNION_TOLERANCE


def _refuse_absent(given: Sequence[str], found: Header) -> None:
    if found.absent:
        raise InputError(
            f"columns names {', '.join(found.absent)}, but the header has "
            f"{', '.join(given)}"
        )


def separator_of(header: str) -> str | None:
    """The separator of a line; None for blanks."""
    return next((mark for mark in (",", ";", "\t") if mark in header), None)


def _split(line: str, separator: str | None) -> list[str]:
    return [cell.strip().strip('"').strip() for cell in line.split(separator)]
