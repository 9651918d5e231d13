"""What trackers export as text: columns of bodies, markers and devices over time.

A reader says which column is which (`Sheet`), `streams` makes the recordings. Markers
make the rigid body of their prefix, ``Body:``, and all others one more.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import FileError
from ttus_opt.probe.column_names import factor, quantity_of
from ttus_opt.probe.raw_recording import COMPONENTS, RawRecording, complete
from ttus_opt.sensors.marker_bodies import body_poses

LOOSE = "its markers move by {:.0f} mm against each other: no rigid body"

#: Markers that move by more than this against each other are of no rigid body [m]
RIGID = 0.005


class Sheet(NamedTuple):
    """Columns of an export.

    Attributes:
        file: Their source.
        time: Shape (T,) [s].
        values: NaN for what is no number, shape (T, columns).
        units: One a column.
        things: Columns of every thing by the package's names, ``px`` to ``tz``: a body
            has positions and quaternions, a marker positions, a device forces.
        frame: Of the positions, for the notes.
        line: Line of each row, shape (T,); none where rows are counted.
        lost: What is said of frames without a pose.
    """

    file: Path
    time: Array
    values: Array
    units: Sequence[str]
    things: Mapping[str, Mapping[str, int]]
    frame: str
    line: IntArray = np.zeros(0, np.int64)
    lost: str = "not tracked"

    def part(self, thing: Mapping[str, int], names: Sequence[str]) -> tuple[Array, str]:
        """Some columns of a thing in SI units, shape (T, k), and their unit.

        Raises:
            FileError: An unknown unit.
        """
        values = self.values[:, [thing[name] for name in names]]
        quantity, unit = quantity_of(names[0]), self.units[thing[names[0]]]
        if quantity in (None, "quaternion"):
            return values, ""
        scale = factor(quantity, unit)
        if scale is None:
            raise FileError(
                f"{self.file}: a {quantity} has the unit {unit!r}: export it again"
            )
        return scale * values, unit


def streams(sheet: Sheet) -> list[RawRecording]:
    """The streams of a sheet: those of bodies and devices, then those of markers.

    Raises:
        FileError: An unknown unit.
    """
    whole = RawRecording(
        str(sheet.file), sheet.time, line=sheet.line, units_stated=True
    )
    out: list[RawRecording] = []
    markers: dict[str, tuple[Array, str]] = {}
    for name, thing in sheet.things.items():
        found = {
            part: sheet.part(thing, names)
            for part, names in COMPONENTS.items()
            if set(names) <= set(thing)
        }
        if [*found] == ["position"]:
            markers[name] = found["position"]
            continue
        is_body = {"position", "quaternion"} <= set(found)
        if not is_body and "force" not in found:
            continue  # its other columns are not there
        parts = {part: values for part, (values, _) in found.items()}
        units = ", ".join(filter(None, (unit for _, unit in found.values())))
        frame = sheet.frame if "position" in parts else "the device's axes"
        raw = whole.replaced(name=name, notes=(f"{units}, {frame}",), **parts)
        if is_body:  # zeros stand for what was not seen, too
            turn = parts["quaternion"]
            lost = ~complete(np.c_[parts["position"], turn]) | ~turn.any(axis=1)
            raw = raw.without(lost, sheet.lost)
        out.append(raw)
    return [*out, *_of_markers(sheet, whole, markers)]


def _of_markers(
    sheet: Sheet, whole: RawRecording, markers: Mapping[str, tuple[Array, str]]
) -> list[RawRecording]:
    """A stream for each body that three or more markers show."""
    groups: dict[str, list[str]] = {}
    for name in markers:
        body, colon, _ = name.partition(":")
        groups.setdefault(body if colon else "markers", []).append(name)
    out = []
    for body, names in groups.items():
        points = [markers[name][0] for name in names]
        poses = body_poses(np.stack(points, axis=1)) if len(points) > 2 else None
        if poses is None:
            continue
        position, quaternion, off = poses
        told = [name.partition(":")[2] or name for name in names[:3]]
        raw = whole.replaced(
            position=position,
            quaternion=quaternion,
            name=body,
            notes=(
                f"{markers[names[0]][1]}, {sheet.frame}",
                f"origin in marker {told[0]}, x towards {told[1]}, z normal to the "
                f"plane with {told[2]}",
            ),
            cautions=(LOOSE.format(1e3 * off),) if off > RIGID else (),
        )
        lost = ~complete(quaternion)
        out.append(raw.without(lost, "seen by fewer than three markers"))
    return out


def read_cells(file: Path, mark: str = ",") -> list[list[str]]:
    """The cells of every line, without blanks around them.

    Raises:
        FileError: Not a text file of cells.
    """
    try:
        with file.open(encoding="utf-8-sig", errors="replace", newline="") as stream:
            rows = csv.reader(stream, delimiter=mark)
            return [[cell.strip() for cell in row] for row in rows]
    except csv.Error as error:
        raise FileError(f"{file} is no CSV file ({error}): export it again") from error


def rows_below(
    file: Path, cells: Sequence[Sequence[str]], head: int
) -> tuple[list[Sequence[str]], IntArray]:
    """Rows that hold something below the header's last line, and their lines, from 1.

    Raises:
        FileError: There are none.
    """
    at = [i for i in range(head + 1, len(cells)) if any(cells[i])]
    if not at:
        raise FileError(
            f"{file} is empty, it has a header and no rows: record it again"
        )
    return [cells[i] for i in at], np.array(at, np.int64) + 1


def number(cell: str) -> float:
    """A cell as a number, NaN where it is none."""
    try:
        return float(cell)
    except ValueError:
        return np.nan


def numbers(rows: Sequence[Sequence[str]], columns: Sequence[int]) -> Array:
    """Cells of rows as numbers, shape (T, columns); NaN for what is none."""
    table = [
        [number(row[c]) if c < len(row) else np.nan for c in columns] for row in rows
    ]
    return np.array(table, np.float64).reshape(len(rows), len(columns))
