"""CSV of OptiTrack's Motive: a header of six or seven lines, bodies and markers.

    Format Version,1.23,…,Rotation Type,Quaternion,Length Units,Millimeters,…
    (empty)
    ,Type,Rigid Body,Rigid Body,…,Marker,…
    ,Name,Probe,Probe,…
    ,ID,…                                    (and Parent, in newer ones)
    ,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,…
    Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,…

A frame in which a body was not seen has empty cells: a gap. Rotations must have been
exported as quaternions; Euler angles are read by the type that the header states.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError
from ttus_opt.probe.column_names import factor
from ttus_opt.probe.raw_recording import RawRecording, complete
from ttus_opt.sensors.marker_bodies import bodies
from ttus_opt.sensors.stream_format import (
    StreamFormat,
    Wanted,
    no_rows,
    numbers,
    read_cells,
)

#: Words in the first column of the last line of the header
FRAME, TIME = "Frame", "Time"


class _Sheet(NamedTuple):
    """The parts of a file.

    Attributes:
        facts: The first line, by name.
        header: Lines of the header by the word in their second cell; those without
            one by ``kind`` (rotation or position) and ``axis``.
        values: Numbers, NaN for empty cells, shape (T, columns).
        line: Line of each row, shape (T,).
    """

    facts: Mapping[str, str]
    header: Mapping[str, Sequence[str]]
    values: Array
    line: np.ndarray


def _read(path: Path, wanted: Wanted) -> list[RawRecording]:
    """One stream a rigid body, and one for the markers of each set.

    Raises:
        FileError: Another header, an unknown unit or rotation, or no rows.
    """
    file = io.existing_file(path, "Motive CSV")
    sheet = _sheet(file)
    unit = sheet.facts.get("Length Units", "")
    scale = factor("position", unit)
    if scale is None:
        raise FileError(f"{file} has Length Units {unit!r}: export it in metres or mm")
    time = sheet.values[:, _time_column(file, sheet.header["axis"])]
    space = sheet.facts.get("Coordinate Space", "Global")
    note = f"{unit}, {space} axes, y upwards unless it was exported otherwise"
    kinds, names = sheet.header["Type"], sheet.header["Name"]
    out = []
    for name in dict.fromkeys(
        n for n, k in zip(names, kinds, strict=False) if k == "Rigid Body"
    ):
        own = [i for i, n in enumerate(names) if n == name and kinds[i] == "Rigid Body"]
        position = _columns(sheet, own, "Position", "XYZ")
        if position is None:
            continue
        quaternion = _turns(file, sheet, own)
        raw = RawRecording(
            str(file),
            time,
            scale * position,
            quaternion,
            line=sheet.line,
            name=name,
            notes=(note,),
            units_stated=True,
        )
        lost = ~complete(np.c_[position, quaternion])
        out.append(raw.without(lost, "not tracked"))
    return [*out, *_markers(file, sheet, time, scale, note, {raw.name for raw in out})]


def _sheet(file: Path) -> _Sheet:
    rows = read_cells(file)
    facts = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    last = next((i for i, row in enumerate(rows) if row[:1] == [FRAME]), None)
    if last is None:
        raise FileError(f"{file} has no line that begins with {FRAME}: export it again")
    header = {"axis": rows[last]}
    for row in rows[1:last]:
        word = row[1] if len(row) > 1 else ""
        if word in ("Type", "Name"):
            header[word] = row
        elif any(cell in ("Position", "Rotation") for cell in row):
            header["kind"] = row
        elif not word and any(cell == "Marker" for cell in row):  # without the word
            header["Type"] = row
    if missing := [word for word in ("Type", "Name", "kind") if word not in header]:
        raise FileError(f"{file} has no header line of {missing[0]}: export it again")
    width = len(rows[last])
    for word, row in header.items():
        header[word] = [*row[:width], *[""] * (width - len(row))]
    lines = [i for i, row in enumerate(rows) if i > last and any(row)]
    if not lines:
        raise no_rows(file)
    values = numbers([rows[i] for i in lines], width)
    return _Sheet(facts, header, values, np.array(lines, np.int64) + 1)


def _time_column(file: Path, axes: Sequence[str]) -> int:
    for i, word in enumerate(axes):
        if word.startswith(f"{TIME} "):
            return i
    raise FileError(f"{file} has no column of times: export it with Time (Seconds)")


def _columns(sheet: _Sheet, own: Sequence[int], kind: str, axes: str) -> Array | None:
    """Some columns of a body in the order of ``axes``; None without them."""
    kinds, names = sheet.header["kind"], sheet.header["axis"]
    at = [
        next((i for i in own if kinds[i : i + 1] == [kind] and names[i] == axis), -1)
        for axis in axes
    ]
    return None if -1 in at else sheet.values[:, at]


def _turns(file: Path, sheet: _Sheet, own: Sequence[int]) -> Array:
    """Quaternions w, x, y, z of a body, NaN where it was not seen, shape (T, 4).

    Raises:
        FileError: An unknown type of rotation.
    """
    kind = sheet.facts.get("Rotation Type", "Quaternion")
    found = _columns(sheet, own, "Rotation", "WXYZ")
    if kind.lower() == "quaternion" and found is not None:
        return found
    angles = _columns(sheet, own, "Rotation", "XYZ")
    if angles is None or sorted(kind.lower()) != ["x", "y", "z"]:
        raise FileError(f"{file} has rotations of type {kind!r}: export Quaternion")
    known = np.isfinite(angles).all(axis=1)
    out = np.full((len(angles), 4), np.nan)
    order = ["XYZ".index(axis) for axis in kind.upper()]
    if known.any():  # Motive's Euler angles turn about the axes turned before
        turns = Rotation.from_euler(kind.upper(), angles[known][:, order], degrees=True)
        out[known] = turns.as_quat(scalar_first=True)
    return out


def _markers(
    file: Path, sheet: _Sheet, time: Array, scale: float, note: str, taken: set[str]
) -> list[RawRecording]:
    """Streams of the markers that belong to no rigid body of the file."""
    kinds, names = sheet.header["Type"], sheet.header["Name"]
    found: dict[str, Array] = {}
    for name in dict.fromkeys(
        n for n, k in zip(names, kinds, strict=False) if k == "Marker"
    ):
        own = [i for i, n in enumerate(names) if n == name and kinds[i] == "Marker"]
        position = _columns(sheet, own, "Position", "XYZ")
        if position is not None and name.partition(":")[0] not in taken:
            found[name] = scale * position
    if not found:
        return []
    points = np.stack(list(found.values()), axis=1)
    return bodies(str(file), time, list(found), points, note)


MOTIVE = StreamFormat(
    "CSV of OptiTrack's Motive",
    lambda file, head: head.lstrip('"').startswith("Format Version"),
    _read,
    "body",
)
