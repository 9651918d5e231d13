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

import numpy as np

from ttus_opt.core.errors import FileError
from ttus_opt.probe.raw_recording import RawRecording
from ttus_opt.sensors.stream_format import StreamFormat, Wanted
from ttus_opt.sensors.tracker_sheet import Sheet, number, numbers, read_cells, streams

FRAME = "Frame"

#: Columns by the package's names
NAMES = {
    **{f"R{x}": f"q{x.lower()}" for x in "WXYZ"},
    **{f"{begin}{x}": f"p{x.lower()}" for x in "XYZ" for begin in ("T", "")},
    **{f"F{x}": f"f{x.lower()}" for x in "XYZ"},
    **{f"M{x}": f"t{x.lower()}" for x in "XYZ"},
}


def _read(file: Path, wanted: Wanted) -> list[RawRecording]:
    """The streams of all sections."""
    out: list[RawRecording] = []
    angles = ""
    for sheet in _sections(file):
        unstated = [
            n for n, own in sheet.things.items() if "qx" in own and "qw" not in own
        ]
        angles = angles or next(iter(unstated), "")
        things = {n: own for n, own in sheet.things.items() if n not in unstated}
        out += streams(sheet._replace(things=things))
    if not out and angles:
        raise FileError(
            f"{file}: {angles} has rotations of three angles, Euler or helical is not "
            "stated: export quaternions (RW), or its markers"
        )
    if not out:
        raise FileError(f"{file} has no objects, markers or forces: export them")
    return out


def _sections(file: Path) -> Iterator[Sheet]:
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
        values = numbers(rows[head + 2 : end], range(width))
        per_frame = int(np.nan_to_num(values[:, 1]).max()) + 1
        steps = values[:, 0] * per_frame + np.nan_to_num(values[:, 1])
        yield Sheet(
            file,
            (steps - per_frame) / rate,  # the first frame is 1
            values,
            [*rows[head + 1], *[""] * width][:width],
            _things(rows[head - 1], columns),
            "frames of Vicon's volume, times from frame 1",
            np.arange(head + 3, end + 1),
        )


def _things(above: Sequence[str], columns: Sequence[str]) -> dict[str, dict[str, int]]:
    """Columns of each name above them; forces joined with moments."""
    out: dict[str, dict[str, int]] = {}
    name = ""
    for i, column in enumerate(columns):
        name = (above[i] if i < len(above) else "") or name
        ours = NAMES.get(column.upper().rstrip("'"))
        if not name or i < 2 or ours is None:
            continue
        title = re.sub(r"^Global Angle ", "", name)
        # a force plate's channels: "Plate - Force", "Plate - Moment"
        title = re.sub(r" - (Force|Moment)$", "", title)
        out.setdefault(title, {}).setdefault(ours, i)
    return out


VICON = StreamFormat(
    "CSV of Vicon",
    lambda file, head: re.search(r"^\"?Frame\"?,\"?Sub Frame", head, re.M) is not None,
    _read,
    "object",
)
