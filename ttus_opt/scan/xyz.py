"""Point clouds as text: x y z, and further columns.

Cells are separated by commas, semicolons, tabs or blanks. Comment lines (``#``, ``%``,
``//``), a line with the number of points (PTS) and a line with the names of the
columns, itself a comment or not, may precede the points. Without names the first three
columns are the coordinates, followed by an intensity, a colour, a normal, or several of
these.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError
from ttus_opt.probe.text_table import COMMENT, are_numbers, separator_of

#: Other programs' names of the coordinates (ParaView)
SAME = {"points:0": "x", "points:1": "y", "points:2": "z"}

#: Columns of unnamed points: coordinates alone, with an intensity, with three numbers
#: (colour or normal), four, six, or seven
WIDTHS = (3, 4, 6, 7, 9, 10)


#: Number of a line that is not empty, and its text
_Line = tuple[int, str]


def read_xyz(file: Path) -> Array:
    """Coordinates of a text file, in the file's own unit and order.

    Args:
        file: The file, known to exist.

    Returns:
        Points, shape (n, 3) [the file's unit].

    Raises:
        FileError: Not text, no points, ambiguous columns, or another number of points
            than the file announces.
    """
    lines = enumerate(map(str.strip, io.read_text(file).splitlines()), start=1)
    names, announced, rows = _preamble([line for line in lines if line[1]])
    if not rows:
        raise FileError(f"{file} holds no points: record or export it again")
    mark = _separator(rows[0][1])
    width = len(rows[0][1].split(mark))
    columns = _columns(file, names, width)
    for number, row in rows:
        found = len(row.split(mark))
        if found != width:
            raise FileError(
                f"{file}, line {number}: {found} columns, expected {width}: "
                "truncated or damaged, export it again"
            )
    if announced is not None and announced != len(rows):
        raise FileError(
            f"{file} announces {announced} points in its first line and holds "
            f"{len(rows)}: truncated or damaged, export it again"
        )
    try:
        values = np.loadtxt(
            [row for _, row in rows], delimiter=mark, usecols=columns, ndmin=2
        )
    except ValueError as error:
        reason = str(error).splitlines()[0]
        raise FileError(
            f"{file} has a value that is not a number ({reason})"
        ) from error
    points = np.asarray(values, dtype=np.float64)
    if not names and width > 3:
        _refuse_a_counter(file, points)
    return points


def _preamble(lines: Sequence[_Line]) -> tuple[list[str], int | None, list[_Line]]:
    """Names of the columns, the announced number of points, and their lines."""
    names: list[str] = []
    announced: int | None = None
    rows: list[_Line] = []
    for line in lines:
        comment = COMMENT.match(line[1])
        words = _words(COMMENT.sub("", line[1]))
        if not rows and not names and {"x", "y", "z"} <= set(words):
            names = words
        elif comment:
            continue
        elif not rows and announced is None and re.fullmatch(r"\d{1,15}", line[1]):
            announced = int(line[1])
        elif not rows and not names and not are_numbers(words[:1]):
            names = words  # refused where they are looked up
        else:
            rows.append(line)
    return names, announced, rows


def _columns(file: Path, names: Sequence[str], width: int) -> list[int]:
    """Columns of x, y and z; `FileError` if they are ambiguous."""
    if names:
        if not {"x", "y", "z"} <= set(names):
            raise FileError(
                f"{file} has the columns {', '.join(names)}, expected x, y and z among "
                "them"
            )
        if len(names) != width:
            raise FileError(
                f"{file} names {len(names)} columns, its points have {width}: repair "
                "the line of names"
            )
        return [names.index(name) for name in "xyz"]
    if width not in WIDTHS:
        raise FileError(
            f"{file} has {width} columns, expected x, y, z alone or with intensity, "
            "colour or normal (3, 4, 6, 7, 9 or 10): name x, y and z in a first line "
            "to select them"
        )
    return [0, 1, 2]


def _refuse_a_counter(file: Path, points: Array) -> None:
    """Refuse unnamed columns whose first counts the points, as in some tables."""
    first = points[:, 0]
    if len(first) > 2 and (np.diff(first) == 1.0).all():
        raise FileError(
            f"{file}: the first column counts the points: name x, y and z in a first "
            "line to select them"
        )


def _words(text: str) -> list[str]:
    """Names on a line, in lower case; other programs' names replaced by ours."""
    words = [w.strip().strip('"').lower() for w in text.split(_separator(text))]
    return [SAME.get(word, word) for word in words if word] or [""]


def _separator(text: str) -> str | None:
    """The separator of a line; None for blanks and tabs."""
    mark = separator_of(text)
    return None if mark == "\t" else mark
