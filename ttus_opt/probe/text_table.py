"""Tables of numbers as text: separators, comments and column names of other programs.

A header names the columns. Comment lines (``#``, ``%``, ``//``) may precede it; the
header may itself be one. Cells are separated by commas, semicolons, tabs or blanks.
Names are accepted in any case, and as ROS exports them (``pose.position.x``,
``/robot/pose/orientation/w``, ``field.wrench.force.z``).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core import io
from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.errors import FileError, InputError, warn

#: Marks of a comment line
COMMENT = re.compile(r"^\s*(#|%|//)\s*")

#: Endings of ROS names, and the columns they stand for
ROS = {
    **{f"position.{c}": f"p{c}" for c in "xyz"},
    **{f"orientation.{c}": f"q{c}" for c in "wxyz"},
    **{f"translation.{c}": f"p{c}" for c in "xyz"},
    **{f"rotation.{c}": f"q{c}" for c in "wxyz"},
    **{f"force.{c}": f"f{c}" for c in "xyz"},
    **{f"torque.{c}": f"t{c}" for c in "xyz"},
    "time": "t",
    "__time": "t",  # PlotJuggler's
    "timestamp": "t",
    "stamp": "t",
}

#: Time stamps above this are in nanoseconds, as ROS writes integers [s]
NANOSECONDS = 1e14

#: Longest part of a header that an error shows [characters]
LONGEST_HEADER = 200


@dataclass(frozen=True)
class TextTable:
    """Cells of a file, not yet read as numbers.

    Attributes:
        file: Their source.
        names: Names of the columns, the package's names where known.
        cells: One list per row, all of the same length.
        line: Line number of each row, from 1, shape (T,).
    """

    file: Path
    names: list[str]
    cells: list[list[str]]
    line: NDArray[np.int64]

    def numbers(self, wanted: Sequence[str]) -> Array:
        """Some columns as numbers, shape (T, len(wanted)).

        Raises:
            FileError: A cell is not a number; the message names its line.
        """
        where = [self.names.index(name) for name in wanted]
        picked = [[row[c] for c in where] for row in self.cells]
        try:
            return np.array(picked, dtype=np.float64).reshape(len(picked), len(where))
        except ValueError:
            raise self._first_fault(picked, wanted) from None

    def _first_fault(
        self, picked: Sequence[Sequence[str]], wanted: Sequence[str]
    ) -> FileError:
        """The error for the first cell that is not a number."""
        for row, cells in enumerate(picked):
            for name, cell in zip(wanted, cells, strict=True):
                try:
                    float(cell)
                except ValueError:
                    found = f"{io.shortened(cell)}, not a number" if cell else "empty"
                    comma = (
                        ", with a decimal comma? write a point" if "," in cell else ""
                    )
                    return FileError(
                        f"{self.file}, line {self.line[row]}: {name} is {found}"
                        f"{comma}: repair or remove the line"
                    )
        raise AssertionError("every cell is a number")


def read_text_table(
    file: Path, required: Sequence[str], columns: Mapping[str, str] | None = None
) -> TextTable:
    """Read a table whose header names the required columns.

    Args:
        file: The file.
        required: Columns that must exist, by the package's names.
        columns: The file's names of columns, by the package's.

    Raises:
        FileError: Not text, no such header, no rows, or a row with another number of
            cells than the header.
        InputError: ``columns`` names a column that does not exist.
    """
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    except (UnicodeDecodeError, OSError) as error:
        raise FileError(
            f"{file} is not a readable text file ({type(error).__name__}): export it "
            "as CSV"
        ) from error
    head, separator, names = _header(file, lines, required, columns or {})
    cells, numbers = [], []
    for number, line in enumerate(lines[head + 1 :], start=head + 2):
        if not line.strip() or COMMENT.match(line):
            continue
        cells.append(_split(line, separator))
        numbers.append(number)
    if not cells:
        raise FileError(
            f"{file} is empty, it has a header and no rows: record or export it again"
        )
    for row, number in zip(cells, numbers, strict=True):
        if len(row) != len(names):
            cut = number == numbers[-1] and len(row) < len(names)
            raise FileError(
                f"{file}, line {number}: {len(row)} cells, the header has "
                f"{len(names)}: "
                + (
                    "the file is truncated, record or copy it again"
                    if cut
                    else "repair or remove the line"
                )
            )
    return TextTable(file, names, cells, np.array(numbers, dtype=np.int64))


def seconds(time: Array) -> Array:
    """Times of a table [s], whole nanoseconds of ROS converted to a quarter of a µs.

    Stamps keep their origin: streams of one clock stay on one clock.
    """
    return 1e-9 * time if len(time) and time.min() > NANOSECONDS else time


def first_of_each(rows: Array, file: Path) -> Mask:
    """Mask of the rows that do not repeat the row before, with a warning of the others.

    A device that sends a reading twice does not measure twice.

    Args:
        rows: Time and all numbers of every reading, shape (T, k).
        file: For the warning.
    """
    new = np.ones(len(rows), bool)
    new[1:] = (rows[1:] != rows[:-1]).any(axis=1)
    if not new.all():
        warn(f"{file}: {(~new).sum()} rows repeat the row before: left out", 2)
    return new


def known_name(name: str) -> str:
    """The package's name for a column, or its own name where it is unknown.

    >>> known_name("/robot/pose/orientation/w"), known_name("FX"), known_name("gain")
    ('qw', 'fx', 'gain')
    >>> {known_name(name) for name in ("stamp", "__time", "field.header.stamp")}
    {'t'}
    """
    plain = name.strip().strip('"').strip()
    dotted = plain.lower().replace("/", ".").lstrip(".")
    if dotted in ROS:
        return ROS[dotted]
    for end, ours in ROS.items():
        if dotted.endswith(f".{end}"):
            return ours
    return dotted if re.fullmatch(r"t|[pft][xyz]|q[wxyz]|segment", dotted) else plain


def _header(
    file: Path,
    lines: Sequence[str],
    required: Sequence[str],
    columns: Mapping[str, str],
) -> tuple[int, str | None, list[str]]:
    """The header's line index, the separator and the names."""
    closest: list[str] | None = None
    for place, line in enumerate(lines):
        if not line.strip():
            continue
        text = COMMENT.sub("", line)
        separator = _separator(text)
        given = [cell.strip().strip('"') for cell in _split(text, separator)]
        names = _renamed(given, columns)
        if not [n for n in required if n not in names]:
            _refuse_absent(given, columns)
            return place, separator, names
        if not COMMENT.match(line):
            closest = names
            break
    missing = [n for n in required if n not in (closest or [])]
    found = ",".join(closest or []) or "none"
    if len(found) > LONGEST_HEADER:
        found = f"{found[:LONGEST_HEADER]}… ({len(closest or []):,} in all)"
    raise FileError(
        f"{file} has no column {', '.join(missing)}: the header must name "
        f"{','.join(required)}, got {found}; map them by columns, for instance px=x"
    )


def _renamed(given: Sequence[str], columns: Mapping[str, str]) -> list[str]:
    """The package's names: those that the user maps, then those that are known."""
    mapped = {theirs: ours for ours, theirs in columns.items()}
    return [
        mapped[name]
        if name in mapped
        else f"{name} (unused)"  # the user maps another column to this name
        if known_name(name) in columns
        else known_name(name)
        for name in given
    ]


def _refuse_absent(given: Sequence[str], columns: Mapping[str, str]) -> None:
    absent = [theirs for theirs in columns.values() if theirs not in given]
    if absent:
        raise InputError(
            f"columns names {', '.join(absent)}, but the header has {', '.join(given)}"
        )


def _separator(header: str) -> str | None:
    """The separator of a line; None for blanks."""
    return next((mark for mark in (",", ";", "\t") if mark in header), None)


def _split(line: str, separator: str | None) -> list[str]:
    return [cell.strip().strip('"').strip() for cell in line.split(separator)]
