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

import numpy as np
from scipy.spatial.transform import Rotation

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError
from ttus_opt.probe.raw_recording import RawRecording
from ttus_opt.sensors.stream_format import StreamFormat, Wanted
from ttus_opt.sensors.tracker_sheet import (
    Sheet,
    numbers,
    read_cells,
    rows_below,
    streams,
)

#: Words in the first column of the last line of the header
FRAME, TIME = "Frame", "Time"

POSITION, TURN = ("px", "py", "pz"), ("qw", "qx", "qy", "qz")


def _read(file: Path, wanted: Wanted) -> list[RawRecording]:
    """One stream a rigid body, and one for the markers of each set."""
    rows = read_cells(file)
    facts = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    last = next((i for i, row in enumerate(rows) if row[:1] == [FRAME]), None)
    if last is None:
        raise FileError(f"{file} has no line that begins with {FRAME}: export it again")
    header = _header(file, rows[: last + 1])
    below, line = rows_below(file, rows, last)
    values = numbers(below, range(len(rows[last])))
    time = next(
        (i for i, w in enumerate(header["axis"]) if w.startswith(f"{TIME} ")), -1
    )
    if time < 0:
        raise FileError(f"{file} has no column of times: export it with Time (Seconds)")
    things: dict[str, dict[str, int]] = {}
    for name, own in _things(header, "Rigid Body").items():
        if set(POSITION) <= set(own):
            values, turn = _turned(file, facts, values, own)
            things[name] = {k: own[k] for k in POSITION} | turn
    for name, own in _things(header, "Marker").items():
        if set(POSITION) <= set(own) and name.partition(":")[0] not in things:
            things[name] = {k: own[k] for k in POSITION}
    space = facts.get("Coordinate Space", "Global")
    sheet = Sheet(
        file,
        values[:, time],
        values,
        [facts.get("Length Units", "")] * values.shape[1],
        things,
        f"{space} axes, y upwards unless it was exported otherwise",
        line,
    )
    return streams(sheet)


def _header(file: Path, rows: Sequence[Sequence[str]]) -> dict[str, list[str]]:
    """Lines of the header by the word in their second cell, as wide as the last.

    Those without one by ``kind`` (rotation or position) and ``axis``.
    """
    header = {"axis": list(rows[-1])}
    for row in rows[1:-1]:
        word = row[1] if len(row) > 1 else ""
        if word in ("Type", "Name"):
            header[word] = list(row)
        elif any(cell in ("Position", "Rotation") for cell in row):
            header["kind"] = list(row)
        elif not word and any(cell == "Marker" for cell in row):  # without the word
            header["Type"] = list(row)
    if missing := [word for word in ("Type", "Name", "kind") if word not in header]:
        raise FileError(f"{file} has no header line of {missing[0]}: export it again")
    width = len(rows[-1])
    return {word: [*row, *[""] * width][:width] for word, row in header.items()}


def _things(
    header: Mapping[str, Sequence[str]], wanted: str
) -> dict[str, dict[str, int]]:
    """Columns of everything of a type, by the package's names."""
    out: dict[str, dict[str, int]] = {}
    words = zip(*(header[k] for k in ("Type", "Name", "kind", "axis")), strict=True)
    for i, (what, name, kind, axis) in enumerate(words):
        if what == wanted and kind in ("Position", "Rotation"):
            ours = f"{'p' if kind == 'Position' else 'q'}{axis.lower()}"
            out.setdefault(name, {}).setdefault(ours, i)
    return out


def _turned(
    file: Path, facts: Mapping[str, str], values: Array, own: Mapping[str, int]
) -> tuple[Array, dict[str, int]]:
    """The values, with a body's quaternions where they were not, and their columns."""
    kind = facts.get("Rotation Type", "Quaternion")
    if kind.lower() == "quaternion" and set(TURN) <= set(own):
        return values, {k: own[k] for k in TURN}
    if not set(TURN[1:]) <= set(own) or sorted(kind.lower()) != ["x", "y", "z"]:
        raise FileError(f"{file} has rotations of type {kind!r}: export Quaternion")
    angles = values[:, [own[f"q{axis}"] for axis in kind.lower()]]
    known = np.isfinite(angles).all(axis=1)
    turns = np.full((len(angles), 4), np.nan)
    if known.any():  # Motive's Euler angles turn about the axes turned before
        found = Rotation.from_euler(kind.upper(), angles[known], degrees=True)
        turns[known] = found.as_quat(scalar_first=True)
    at = range(values.shape[1], values.shape[1] + 4)
    return np.c_[values, turns], dict(zip(TURN, at, strict=True))


MOTIVE = StreamFormat(
    "CSV of OptiTrack's Motive",
    lambda file, head: head.lstrip('"').startswith("Format Version"),
    _read,
    "body",
)
