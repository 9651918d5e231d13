"""TRC files of marker positions (Motion Analysis, OpenSim, Cortex, Qualisys).

    PathFileType  4  (X/Y/Z)  press.trc
    DataRate  CameraRate  NumFrames  NumMarkers  Units  …
    100.00    100.00      400        4           mm     …
    Frame#  Time  Probe:A  (empty)  (empty)  Probe:B  …
    (empty) (empty)  X1  Y1  Z1  X2  Y2  Z2  …

A TRC file has no rotations: the poses are those of the rigid body of each set of
markers (`ttus_opt.sensors.marker_bodies`).
"""

from __future__ import annotations

from pathlib import Path

from ttus_opt.core import io
from ttus_opt.core.errors import FileError
from ttus_opt.probe.column_names import factor
from ttus_opt.probe.raw_recording import RawRecording
from ttus_opt.sensors.marker_bodies import bodies
from ttus_opt.sensors.stream_format import StreamFormat, Wanted, no_rows, numbers


def _read(path: Path, wanted: Wanted) -> list[RawRecording]:
    """One stream a set of three or more markers.

    Raises:
        FileError: Another header, an unknown unit, no rows, or fewer than 3 markers.
    """
    file = io.existing_file(path, "TRC file")
    text = file.read_text(encoding="utf-8-sig", errors="replace")
    lines = [line.split("\t") for line in text.splitlines()]
    if len(lines) < 6:
        raise no_rows(file)
    facts = dict(zip(map(str.strip, lines[1]), map(str.strip, lines[2]), strict=False))
    unit = facts.get("Units", "")
    scale = factor("position", unit)
    if scale is None:
        raise FileError(
            f"{file} has Units {unit!r}, expected m, cm or mm: export again"
        )
    names = [word.strip() for word in lines[3][2:] if word.strip()]
    width = 2 + 3 * len(names)
    rows = [line for line in lines[5:] if line and line[0].strip()]
    values = numbers(rows, width)
    if not len(values):
        raise no_rows(file)
    points = scale * values[:, 2:].reshape(len(rows), len(names), 3)
    note = f"{unit}, axes of the file"
    found = bodies(str(file), values[:, 1], names, points, note)
    if not found:
        raise FileError(
            f"{file} has no three markers of one body that are seen at once and off "
            "one line: a pose needs them"
        )
    return found


TRC = StreamFormat(
    "TRC file of markers",
    lambda file, head: head.startswith("PathFileType"),
    _read,
    "body",
)
