"""CSV of Vicon's Nexus and Tracker: sections of objects, markers and devices.

    Objects
    100
    ,,Probe:Probe,,,,,,
    Frame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ
    ,,,,,,mm,mm,mm
    1,0,0.01,…

A section is its name, its rate [Hz], names above the columns, columns, units, rows, and
an empty line. Segments and objects are poses, trajectories are markers, and the forces
of a device with its moments are wrenches. Three angles without RW may be Euler angles
or a rotation vector: they are not guessed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError
from ttus_opt.probe.column_names import factor
from ttus_opt.probe.raw_recording import RawRecording, complete
from ttus_opt.sensors.marker_bodies import bodies
from ttus_opt.sensors.stream_format import (
    StreamFormat,
    Wanted,
    number,
    numbers,
    read_cells,
)

FRAME = "Frame"


class _Section(NamedTuple):
    """A section of a file.

    Attributes:
        time: Frame, and sub-frame where frames have several, by the rate, (T,) [s].
        blocks: Name, columns by their axis, and their units, of each thing.
        values: NaN for empty cells, shape (T, columns).
        line: Shape (T,).
    """

    time: Array
    blocks: dict[str, dict[str, int]]
    units: Sequence[str]
    values: Array
    line: np.ndarray


def _read(path: Path, wanted: Wanted) -> list[RawRecording]:
    """The streams of all sections.

    Raises:
        FileError: A damaged section, angles of an unstated kind, or no stream.
    """
    file = io.existing_file(path, "Vicon CSV")
    out: list[RawRecording] = []
    markers: list[tuple[_Section, str]] = []
    angles = ""
    for section in _sections(file):
        for name, axes in section.blocks.items():
            if {"RX", "RY", "RZ", "RW", "TX", "TY", "TZ"} <= set(axes):
                out.append(_object(file, section, name))
            elif {"RX", "TX"} <= set(axes):
                angles = angles or name
            elif {"FX", "FY", "FZ"} <= set(axes):
                out.append(_device(file, section, name))
            elif {"X", "Y", "Z"} <= set(axes):
                markers.append((section, name))
    out += _of_markers(file, markers)
    if not out and angles:
        raise FileError(
            f"{file}: {angles} has rotations of three angles, Euler or helical is not "
            "stated: export quaternions (RW), or its markers"
        )
    if not out:
        raise FileError(f"{file} has no objects, markers or forces: export them")
    return out


def _sections(file: Path) -> Iterator[_Section]:
    rows = read_cells(file)
    for head in [i for i, row in enumerate(rows) if row[:1] == [FRAME] and i >= 2]:
        rate = number(rows[head - 2][0]) if rows[head - 2] else np.nan
        if not 0.0 < rate < np.inf:
            raise FileError(f"{file}, line {head - 1}: a rate in Hz was expected")
        end = head + 2
        while end < len(rows) and any(rows[end]):
            end += 1
        if end == head + 2:
            raise FileError(f"{file}, line {head + 1}: a section without rows")
        columns, width = rows[head], len(rows[head])
        if width < 3:
            raise FileError(f"{file}, line {head + 1}: no columns beside the frame's")
        values = numbers(rows[head + 2 : end], width)
        per_frame = int(np.nan_to_num(values[:, 1]).max()) + 1
        steps = values[:, 0] * per_frame + np.nan_to_num(values[:, 1])
        time = (steps - per_frame) / rate  # the first frame is 1
        line = np.arange(head + 3, end + 1)
        units = [*rows[head + 1], *[""] * width][:width]
        yield _Section(time, _blocks(rows[head - 1], columns), units, values, line)


def _blocks(above: Sequence[str], columns: Sequence[str]) -> dict[str, dict[str, int]]:
    """Columns by their axis, of each name above them; forces joined with moments."""
    out: dict[str, dict[str, int]] = {}
    name = ""
    for i, column in enumerate(columns):
        name = (above[i] if i < len(above) else "") or name
        if not name or i < 2:
            continue
        title = re.sub(r"^Global Angle ", "", name)
        # a force plate's channels: "Plate - Force", "Plate - Moment"
        title = re.sub(r" - (Force|Moment)$", "", title)
        out.setdefault(title, {}).setdefault(column.upper().rstrip("'"), i)
    return out


def _object(file: Path, section: _Section, name: str) -> RawRecording:
    axes = section.blocks[name]
    scale, unit = _scale(file, section, axes["TX"], "position")
    position = section.values[:, [axes[f"T{x}"] for x in "XYZ"]]
    quaternion = section.values[:, [axes[f"R{x}"] for x in "WXYZ"]]
    raw = RawRecording(
        str(file),
        section.time,
        scale * position,
        quaternion,
        line=section.line,
        name=name,
        notes=(f"{unit}, frames of Vicon's volume, times from frame 1",),
        units_stated=True,
    )
    lost = ~complete(np.c_[position, quaternion])
    lost |= ~quaternion.any(axis=1)  # Tracker writes zeros for what it does not see
    return raw.without(lost, "not tracked")


def _device(file: Path, section: _Section, name: str) -> RawRecording:
    axes = section.blocks[name]
    scale, unit = _scale(file, section, axes["FX"], "force")
    torque, notes = None, [unit]
    if {"MX", "MY", "MZ"} <= set(axes):
        turning, word = _scale(file, section, axes["MX"], "torque")
        torque = turning * section.values[:, [axes[f"M{x}"] for x in "XYZ"]]
        notes.append(word)
    return RawRecording(
        str(file),
        section.time,
        force=scale * section.values[:, [axes[f"F{x}"] for x in "XYZ"]],
        torque=torque,
        line=section.line,
        name=name,
        notes=(f"{', '.join(notes)}, the device's axes",),
        units_stated=True,
    )


def _of_markers(
    file: Path, markers: Sequence[tuple[_Section, str]]
) -> list[RawRecording]:
    if not markers:
        return []
    section = markers[0][0]
    names = [name for own, name in markers if own is section]
    scale, unit = _scale(file, section, section.blocks[names[0]]["X"], "position")
    points = np.stack(
        [
            scale * section.values[:, [section.blocks[name][x] for x in "XYZ"]]
            for name in names
        ],
        axis=1,
    )
    note = f"{unit}, frames of Vicon's volume, times from frame 1"
    return bodies(str(file), section.time, names, points, note)


def _scale(
    file: Path, section: _Section, column: int, quantity: str
) -> tuple[float, str]:
    """Factor to SI of a column's unit, and the unit.

    Raises:
        FileError: An unknown unit.
    """
    unit = section.units[column]
    found = factor(quantity, unit)
    if found is None:
        raise FileError(f"{file}: a {quantity} has the unit {unit!r}: export it again")
    return found, unit


VICON = StreamFormat(
    "CSV of Vicon",
    lambda file, head: re.search(r"^\"?Frame\"?,\"?Sub Frame", head, re.M) is not None,
    _read,
    "object",
)
