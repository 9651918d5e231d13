"""The trajectory CSV file: its columns, read with every fault named by its line."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError, MistakeWarning, warn
from ttus_opt.probe.pose import QUATERNION_TOLERANCE
from ttus_opt.probe.text_table import first_of_each, read_text_table, seconds

TIME = ("t",)
POSITION = ("px", "py", "pz")
QUATERNION = ("qw", "qx", "qy", "qz")
FORCE = ("fx", "fy", "fz")
TORQUE = ("tx", "ty", "tz")
SEGMENT = "segment"

#: Sizes above which a column is in another unit: [m], [N], [N·m].
MOST_POSITION, MOST_FORCE, MOST_TORQUE = 10.0, 1e3, 1e2

#: Frames further apart than this are taken for times in milliseconds [s]
SLOW = 5.0


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


def read_trajectory_columns(
    path: str | os.PathLike[str], columns: Mapping[str, str] | None = None
) -> TrajectoryColumns:
    """Read and check the columns of a trajectory file.

    Args:
        path: The CSV file.
        columns: The file's own names of columns, by the package's.

    Returns:
        The columns; see `ttus_opt.probe.trajectory.read_trajectory` for the rules.

    Raises:
        FileError: Anything that is not a usable trajectory.
    """
    table = _read_table(io.existing_file(path, "trajectory"), columns)
    position = table.columns(POSITION)
    _require_below(table, position, MOST_POSITION, "m", "millimetres? divide by 1000")
    segment = _segments(table)
    time = seconds(table.columns(TIME)[:, 0])
    _require_increasing(table, time, segment)
    _warn_of_milliseconds(table, time, segment)
    quaternion = _unit_quaternions(table)
    force = torque = None
    if FORCE[0] in table.names:
        force = table.columns(FORCE)
        _require_below(table, force, MOST_FORCE, "N", "millinewtons? convert to N")
    if TORQUE[0] in table.names:
        torque = table.columns(TORQUE)
        _require_below(table, torque, MOST_TORQUE, "N·m", "N·mm? divide by 1000")
    return TrajectoryColumns(time, position, quaternion, force, torque, segment)


def _read_table(file: Path, columns: Mapping[str, str] | None) -> _Table:
    required = (*TIME, *POSITION, *QUATERNION)
    text = read_text_table(file, required, columns)
    known = (*required, *FORCE, *TORQUE, SEGMENT)
    wanted = [name for name in text.names if name in known]
    twice = sorted({name for name in wanted if wanted.count(name) > 1})
    if twice:
        raise FileError(
            f"trajectory {file} has column {', '.join(twice)} more than once: remove "
            "one"
        )
    _refuse_half_a_wrench(file, wanted)
    values = text.numbers(wanted)
    new = first_of_each(values, file)
    values = values[new]
    table = _Table(file, tuple(wanted), values, text.line[new])
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        row, column = bad[0]
        raise table.fail(
            int(row),
            f"{wanted[column]} is {values[row, column]}: remove the "
            f"{len(np.unique(bad[:, 0]))} line(s) with missing values",
        )
    return table


def _refuse_half_a_wrench(file: Path, names: Sequence[str]) -> None:
    """Forces are three columns or none, and so are torques beside them."""
    for own in (FORCE, TORQUE):
        missing = [name for name in own if name not in names]
        if 0 < len(missing) < 3:
            raise FileError(
                f"trajectory {file} has no column {', '.join(missing)}: it needs "
                f"{','.join(own)}, all or none"
            )
    if TORQUE[0] in names and FORCE[0] not in names:
        raise FileError(
            f"trajectory {file} has no column {', '.join(FORCE)}: torques need forces "
            "too"
        )


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


def _warn_of_milliseconds(
    table: _Table, time: Array, segment: NDArray[np.int64]
) -> None:
    steps = np.diff(time)[np.diff(segment) == 0]
    if len(steps) and np.median(steps) > SLOW:
        warn(
            f"{table.file}: frames are {np.median(steps):.3g} s apart: are the times "
            "in milliseconds? divide t by 1000",
            kind=MistakeWarning,
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
