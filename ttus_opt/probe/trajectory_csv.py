"""The trajectory CSV file: its columns, read with every fault named by its line."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ttus_opt import io
from ttus_opt.arrays import Array
from ttus_opt.errors import FileError
from ttus_opt.probe.pose import QUATERNION_TOLERANCE

TIME = ("t",)
POSITION = ("px", "py", "pz")
QUATERNION = ("qw", "qx", "qy", "qz")
FORCE = ("fx", "fy", "fz")
TORQUE = ("tx", "ty", "tz")
SEGMENT = "segment"

#: Sizes above which a column is in another unit: [m], [N], [N·m].
MOST_POSITION, MOST_FORCE, MOST_TORQUE = 10.0, 1e3, 1e2


@dataclass(frozen=True)
class _Table:
    """The numbers of a file and where they stood."""

    file: Path
    names: tuple[str, ...]
    values: Array
    line: NDArray[np.int64]

    def columns(self, names: Sequence[str]) -> Array:
        return self.values[:, [self.names.index(n) for n in names]]

    def fail(self, row: int, what: str) -> FileError:
        return FileError(f"trajectory {self.file}, line {self.line[row]}: {what}")


@dataclass(frozen=True)
class TrajectoryColumns:
    """The checked content of a file.

    Attributes:
        time: Increasing within a segment, shape (T,) [s].
        position: Shape (T, 3) [m].
        quaternion: w, x, y, z, of unit length, shape (T, 4) [–].
        force: Shape (T, 3) [N], or None.
        torque: Shape (T, 3) [N·m], or None.
        segment: Number of the recording, shape (T,) [–].
    """

    time: Array
    position: Array
    quaternion: Array
    force: Array | None
    torque: Array | None
    segment: NDArray[np.int64]


def read_trajectory_columns(path: str | os.PathLike[str]) -> TrajectoryColumns:
    """Read and check the columns of a trajectory file.

    Args:
        path: The CSV file.

    Returns:
        The columns; see `ttus_opt.probe.trajectory.read_trajectory` for the rules.

    Raises:
        FileError: Anything that is not a usable trajectory.
    """
    table = _read_table(io.existing_file(path, "trajectory"))
    position = table.columns(POSITION)
    _require_below(table, position, MOST_POSITION, "m", "millimetres? divide by 1000")
    segment = _segments(table)
    time = table.columns(TIME)[:, 0]
    _require_increasing(table, time, segment)
    quaternion = _unit_quaternions(table)
    force = torque = None
    if FORCE[0] in table.names:
        force, torque = table.columns(FORCE), table.columns(TORQUE)
        _require_below(table, force, MOST_FORCE, "N", "millinewtons? convert to N")
        _require_below(table, torque, MOST_TORQUE, "N·m", "N·mm? divide by 1000")
    return TrajectoryColumns(time, position, quaternion, force, torque, segment)


def _read_table(file: Path) -> _Table:
    try:
        text = file.read_text(encoding="utf-8-sig")
    except (UnicodeDecodeError, OSError) as error:
        raise FileError(
            f"trajectory {file} is not a readable text file ({type(error).__name__}): "
            "export it as CSV"
        ) from error
    lines = text.splitlines()
    names = _header(file, lines[0] if lines else "")
    kept = [i for i, line in enumerate(lines) if i and line.strip()]
    if not kept:
        raise FileError(
            f"trajectory {file} is empty, it has a header and no frames: record or "
            "export it again"
        )
    commas = len(names) - 1
    for i in kept:
        found = lines[i].count(",")
        if found != commas:
            raise FileError(
                f"trajectory {file}, line {i + 1}: {found + 1} cells, the header has "
                f"{commas + 1}: "
                + (
                    "the file is truncated, record or copy it again"
                    if i == kept[-1] and found < commas
                    else "repair or remove the line"
                )
            )
    known = (*TIME, *POSITION, *QUATERNION, *FORCE, *TORQUE, SEGMENT)
    wanted = [n for n in names if n in known]
    where = [names.index(n) for n in wanted]
    try:
        values = np.loadtxt(
            [lines[i] for i in kept],
            delimiter=",",
            usecols=where,
            ndmin=2,
            comments=None,
        )
    except ValueError:
        values = _read_slowly(file, lines, kept, names, where)
    table = _Table(file, tuple(wanted), values, np.array(kept) + 1)
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        row, column = bad[0]
        raise table.fail(
            int(row),
            f"{wanted[column]} is {values[row, column]}: remove the "
            f"{len(np.unique(bad[:, 0]))} line(s) with missing values",
        )
    return table


def _header(file: Path, line: str) -> list[str]:
    names = [name.strip().strip('"') for name in line.split(",")]
    required = (*TIME, *POSITION, *QUATERNION)
    wrench = (*FORCE, *TORQUE)
    missing = [n for n in required if n not in names]
    if any(n in names for n in wrench):
        missing += [n for n in wrench if n not in names]
    expected = ",".join((*required, *wrench))
    if missing:
        hint = "separate by commas, " if ";" in line or "\t" in line else ""
        raise FileError(
            f"trajectory {file} has no column {', '.join(missing)}: {hint}the header "
            f"must be {expected} (the last six all or none)"
        )
    twice = sorted(
        {n for n in names if n in (*required, *wrench, SEGMENT) and names.count(n) > 1}
    )
    if twice:
        raise FileError(
            f"trajectory {file} has column {', '.join(twice)} more than once: remove "
            "one"
        )
    return names


def _read_slowly(
    file: Path, lines: list[str], kept: list[int], names: list[str], where: list[int]
) -> Array:
    """Cell by cell, to name the one that is no number."""
    values = np.empty((len(kept), len(where)))
    for row, i in enumerate(kept):
        cells = lines[i].split(",")
        for column, c in enumerate(where):
            cell = cells[c].strip().strip('"')
            try:
                values[row, column] = float(cell)
            except ValueError:
                found = f"{cell!r}, not a number" if cell else "empty"
                raise FileError(
                    f"trajectory {file}, line {i + 1}: {names[c]} is {found}: repair "
                    "or remove the line"
                ) from None
    return values


def _segments(table: _Table) -> NDArray[np.int64]:
    if SEGMENT not in table.names:
        return np.zeros(len(table.values), dtype=np.int64)
    values = table.columns([SEGMENT])[:, 0]
    whole = np.abs(values) < 2**53
    whole &= values == np.round(values)
    if not whole.all():
        row = int(np.argmin(whole))
        raise table.fail(row, f"segment must be a whole number, got {values[row]:.6g}")
    return np.asarray(values.astype(np.int64))


def _require_below(
    table: _Table, values: Array, most: float, unit: str, remedy: str
) -> None:
    size = np.abs(values).max(axis=1)
    if size.max() > most:
        row = int(np.argmax(size > most))
        raise table.fail(
            row, f"{size[row]:.6g} {unit} is not plausible (over {most:g}): {remedy}"
        )


def _require_increasing(table: _Table, time: Array, segment: NDArray[np.int64]) -> None:
    late = np.flatnonzero((np.diff(time) <= 0) & (np.diff(segment) == 0))
    if len(late):
        i = int(late[0]) + 1
        kind = "repeats" if time[i] == time[i - 1] else "goes back from"
        raise table.fail(
            i,
            f"time {time[i]:.9g} s {kind} {time[i - 1]:.9g} s: sort by t and drop "
            "duplicates",
        )


def _unit_quaternions(table: _Table) -> Array:
    quaternion = table.columns(QUATERNION)
    length = np.linalg.norm(quaternion, axis=1)
    bad = np.abs(length - 1.0) > QUATERNION_TOLERANCE
    if bad.any():
        row = int(bad.argmax())
        what = (
            "the quaternion is zero: that frame has no orientation, remove the line"
            if length[row] < 1e-9
            else f"the quaternion has length {length[row]:.6g}, expected 1: normalise "
            "qw,qx,qy,qz"
        )
        raise table.fail(row, what)
    return np.asarray(quaternion / length[:, None])
