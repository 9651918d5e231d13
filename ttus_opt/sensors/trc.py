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

from ttus_opt.core.errors import FileError
from ttus_opt.probe.raw_recording import COMPONENTS, RawRecording
from ttus_opt.sensors.stream_format import StreamFormat, Wanted
from ttus_opt.sensors.tracker_sheet import (
    Sheet,
    numbers,
    read_cells,
    rows_below,
    streams,
)


def _read(file: Path, wanted: Wanted) -> list[RawRecording]:
    """One stream a set of three or more markers."""
    lines = read_cells(file, "\t")
    rows, _ = rows_below(file, lines, 4)
    facts = dict(zip(lines[1], lines[2], strict=False))
    names = [word for word in lines[3][2:] if word]
    values = numbers(rows, range(2 + 3 * len(names)))
    things = {
        name: {x: 2 + 3 * k + i for i, x in enumerate(COMPONENTS["position"])}
        for k, name in enumerate(names)
    }
    units = [facts.get("Units", "")] * values.shape[1]
    sheet = Sheet(file, values[:, 1], values, units, things, "axes of the file")
    if not (found := streams(sheet)):
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
