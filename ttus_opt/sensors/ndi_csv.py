"""Recordings of NDI's trackers (Polaris, Vega, Aurora): ToolBox and the Combined API.

    Tools,Port 0x01: Probe  s/n:3E4C,Frame,Time [sec],Face,State,Q0,…,Tx,Ty,Tz,Error,…
    #Tools,ToolInfo,Frame#,PortHandle,Face#,TransformStatus,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,…

One block of columns a tool, markers behind it. Positions are in mm. A frame whose state
is ``Missing``, or whose numbers are, is a gap. Frames are numbered at `RATE` where
nothing else gives the time.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ttus_opt.core.arrays import Array
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

POSE = ("q0", "qx", "qy", "qz", "tx", "ty", "tz")
OURS = {
    n: i for i, n in enumerate((*COMPONENTS["quaternion"], *COMPONENTS["position"]))
}

#: Rate at which a Polaris or Vega numbers its frames [Hz]; an Aurora has 40
RATE = 60.0

#: Larger numbers stand for what was not seen
NO_NUMBER = 1e20

SOUND = ("ok", "enabled", "valid", "")

#: Names of columns and where they stand
Columns = Sequence[tuple[str, int]]

HEADER = re.compile(r"^.*q0\"?,\"?qx\"?,\"?qy\"?,\"?qz\"?,\"?tx\"?,", re.I | re.M)


def _read(file: Path, wanted: Wanted) -> list[RawRecording]:
    """One stream a tool."""
    table = read_cells(file)
    head = next((i for i, row in enumerate(table) if _poses(row)), None)
    if head is None:
        raise FileError(f"{file} has no line Q0,Qx,Qy,Qz,Tx,Ty,Tz: export it again")
    rows, line = rows_below(file, table, head)
    starts = _poses(table[head])
    out = []
    for which, at in enumerate(starts):
        begin = starts[which - 1] + len(POSE) if which else 0
        # nearest first: what stands before may be another tool's markers
        columns = reversed(range(begin, at))
        about = [(table[head][i].lower(), i) for i in columns]
        pose = numbers(rows, range(at, at + len(POSE)))
        state = _first(about, "status", "state")
        said = [_cell(row, state).lower() for row in rows]
        absent = np.abs(np.nan_to_num(pose, nan=np.inf)).max(axis=1) > NO_NUMBER
        pose[absent | [word not in SOUND for word in said]] = np.nan
        time, how = _times(rows, about)
        sheet = Sheet(
            file,
            time,
            pose,
            ["mm"] * len(POSE),
            {_name(table[head], rows, about) or f"tool {which + 1}": OURS},
            "quaternions w, x, y, z, the tracker's frame",
            line,
            "missing",
        )
        out += [raw.replaced(cautions=(how,) if how else ()) for raw in streams(sheet)]
    return out


def _poses(row: Sequence[str]) -> list[int]:
    """Where the pose of each tool begins."""
    names = [cell.lower() for cell in row]
    return [i for i in range(len(names)) if tuple(names[i : i + len(POSE)]) == POSE]


def _name(header: Sequence[str], rows: Sequence[Sequence[str]], about: Columns) -> str:
    """A tool's name, in its header or in the rows; empty where none is."""
    tool = _first(about, "port 0x", "port ", "toolinfo", "tool")
    title = header[tool] if tool is not None else ""
    if ":" not in title:
        title = next((c for row in rows if (c := _cell(row, tool))), "")
    return re.split(r"\s+s/n:", title.split(": ", 1)[-1])[0].strip()


def _times(rows: Sequence[Sequence[str]], about: Columns) -> tuple[Array, str]:
    """Times [s], and what was taken for granted of them."""
    whole, part = _first(about, "timespec_s"), _first(about, "timespec_n", "timespec_m")
    clock = _first(about, "time")
    frame = _first(about, "frame")
    if whole is not None and part is not None:
        scale = 1e-9 if any("timespec_n" in name for name, _ in about) else 1e-3
        parts = numbers(rows, [whole, part])
        return parts[:, 0] + scale * parts[:, 1], ""
    if clock is not None and np.isfinite(at := numbers(rows, [clock])[:, 0]).any():
        return at, ""
    if frame is None:
        return np.full(len(rows), np.nan), "no times and no frame numbers"
    at = numbers(rows, [frame])[:, 0]
    return at / RATE, f"no times: frame numbers at {RATE:g} Hz (Polaris, Vega)"


def _first(about: Columns, *words: str) -> int | None:
    """The column of the first of these words that a name contains."""
    for word in words:
        for name, index in about:
            if word in name and not (word == "time" and "timespec" in name):
                return index
    return None


def _cell(row: Sequence[str], at: int | None) -> str:
    return row[at] if at is not None and at < len(row) else ""


NDI = StreamFormat(
    "recording of an NDI tracker",
    lambda file, head: HEADER.search(head) is not None,
    _read,
    "tool",
)
