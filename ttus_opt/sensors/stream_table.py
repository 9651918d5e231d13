"""Tables as text: one stream of poses, of wrenches, or of both."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ttus_opt.core import io
from ttus_opt.probe.raw_recording import RawRecording
from ttus_opt.probe.text_table import MissingColumnsError
from ttus_opt.probe.trajectory_csv import raw_trajectory
from ttus_opt.sensors.column_map import table_columns
from ttus_opt.sensors.stream_format import StreamFormat, Wanted
from ttus_opt.sensors.streams import raw_wrenches

#: First letters of the columns of each kind of stream
POSES, WRENCHES = ("p", "q", "rv"), ("f", "t")


def _read(path: Path, wanted: Wanted) -> list[RawRecording]:
    """The table's stream of the wanted kind; of any kind, poses if it has them.

    Raises:
        FileError: Not such a table.
    """
    columns = table_columns(wanted.columns)
    if wanted.kind == "wrenches":
        return [raw_wrenches(io.existing_file(path, "wrench"), _of(columns, WRENCHES))]
    if wanted.kind == "poses":
        return [raw_trajectory(path, _of(columns, POSES))]
    try:
        return [raw_trajectory(path, columns)]
    except MissingColumnsError as poses:
        if wanted.kind:
            raise
        try:
            return [raw_wrenches(io.existing_file(path, "wrench"), columns)]
        except MissingColumnsError as wrenches:
            raise poses.either(wrenches) from None


def _of(columns: Mapping[str, str], kinds: tuple[str, ...]) -> Mapping[str, str]:
    """The columns of one kind of stream, from a map for both."""
    own = ("t", "segment", *(f"{kind}{x}" for kind in kinds for x in "wxyz"))
    return {ours: theirs for ours, theirs in columns.items() if ours in own}


TABLE = StreamFormat("table", lambda file, head: True, _read, has_columns=True)
