"""Recordings of poses and wrenches of any known format.

`FORMATS` is the list; a file belongs to the first that recognises it. A format of your
own is a `StreamFormat` more.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from ttus_opt.core import io
from ttus_opt.core.errors import FileError, InputError, warn
from ttus_opt.probe.raw_recording import RawRecording
from ttus_opt.probe.repair import repaired_aloud
from ttus_opt.probe.text_table import MissingColumnsError
from ttus_opt.probe.trajectory import Trajectory, trajectory_of
from ttus_opt.probe.trajectory_csv import raw_trajectory
from ttus_opt.sensors.ati_log import ATI
from ttus_opt.sensors.column_map import table_columns
from ttus_opt.sensors.motive_csv import MOTIVE
from ttus_opt.sensors.ndi_csv import NDI
from ttus_opt.sensors.netcdf_stream import NETCDF
from ttus_opt.sensors.plus_sequence import PLUS
from ttus_opt.sensors.ros_bag import ROS
from ttus_opt.sensors.stream_format import HEAD, StreamFormat, Wanted, chosen
from ttus_opt.sensors.streams import WrenchStream, raw_wrenches, wrenches_of
from ttus_opt.sensors.trc import TRC
from ttus_opt.sensors.vicon_csv import VICON

#: First letters of the columns of each kind of stream
POSES, WRENCHES = ("p", "q", "rv"), ("f", "t")


def _read(path: Path, wanted: Wanted) -> list[RawRecording]:
    """The table's stream of the wanted kind; of any kind, poses if it has them."""
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
            raw = raw_wrenches(io.existing_file(path, "wrench"), columns)
            return [raw.noted(*poses.nearly())]
        except MissingColumnsError as wrenches:
            raise poses.either(wrenches) from None


def _of(columns: Mapping[str, str], kinds: tuple[str, ...]) -> Mapping[str, str]:
    """The columns of one kind of stream, from a map for both."""
    own = ("t", "segment", *(f"{kind}{x}" for kind in kinds for x in "wxyz"))
    return {ours: theirs for ours, theirs in columns.items() if ours in own}


TABLE = StreamFormat("table", lambda file, head: True, _read, has_columns=True)


LOG = logging.getLogger(__name__)

#: In the order in which a file is tried; a table is what nothing else is
FORMATS: tuple[StreamFormat, ...] = (
    *(ROS, PLUS, NETCDF, MOTIVE, TRC, VICON, NDI, ATI),
    TABLE,
)


def read_poses(
    path: str | os.PathLike[str],
    name: str | None = None,
    columns: Mapping[str, str] | None = None,
    *,
    repair: bool = False,
) -> Trajectory:
    """Poses of a file.

    Args:
        path: The file, or the folder of a ROS 2 recording.
        name: The transform, topic, body or marker set, where there are several; of
            ``/tf`` two frames, ``base:tool``.
        columns: The file's names, by the package's (`read_column_map`).
        repair: Mend holes, with a warning of what was done (`ttus_opt.probe.repair`).

    Raises:
        FileError: The file cannot be read.
        InputError: Such a file has no names or no columns.
    """
    raw = raw_stream(path, Wanted(name, columns or {}, "poses"), repair=repair)
    return trajectory_of(raw.replaced(force=None, torque=None))


def read_wrenches(
    path: str | os.PathLike[str],
    name: str | None = None,
    columns: Mapping[str, str] | None = None,
    *,
    repair: bool = False,
) -> WrenchStream:
    """Wrenches of a file; arguments and errors as `read_poses`."""
    raw = raw_stream(path, Wanted(name, columns or {}, "wrenches"), repair=repair)
    return wrenches_of(raw)


def read_recording(
    path: str | os.PathLike[str],
    name: str | None = None,
    columns: Mapping[str, str] | None = None,
    *,
    repair: bool = False,
) -> Trajectory:
    """Poses of a file with the wrenches that it has beside them in the same rows.

    Arguments and errors as `read_poses`.
    """
    raw = raw_stream(path, Wanted(name, columns or {}, "recording"), repair=repair)
    return trajectory_of(raw)


def raw_stream(
    path: str | os.PathLike[str], wanted: Wanted, *, repair: bool = False
) -> RawRecording:
    """A stream as its file has it; a warning tells what was taken for granted.

    Units and frames are logged (``ttus_opt.sensors.stream_files``, INFO).

    Raises:
        FileError: The file cannot be read, or has no such stream.
        InputError: Such a file has no names or no columns.
    """
    file, kind, found = _found(path, wanted)
    raw = chosen(file, found, wanted, kind.word)
    LOG.info("%s, %s: %s", raw.title, kind.title, "; ".join(raw.notes) or "SI units")
    if raw.cautions:
        warn(f"{raw.title}: {'; '.join(raw.cautions)}", 2)
    return repaired_aloud(raw) if repair else raw


def raw_recordings(
    path: str | os.PathLike[str],
    columns: Mapping[str, str] | None = None,
    name: str | None = None,
) -> Sequence[RawRecording]:
    """All streams of a file, or those of a name; errors as `raw_stream`."""
    file, kind, found = _found(path, Wanted(name, columns or {}))
    if name is None:
        return found
    own = [raw for raw in found if raw.name == name]
    if not own:
        names = ", ".join(raw.name for raw in found) or "none"
        raise FileError(f"{file} has no {kind.word} {name}, but {names}")
    return own


def format_of(file: Path) -> StreamFormat:
    """The format of a file, by its name and the text it begins with.

    Raises:
        FileError: It cannot be opened.
    """
    head = ""
    if file.is_file():
        try:
            with file.open("rb") as stream:
                head = stream.read(HEAD).decode("utf-8-sig", errors="replace")
        except OSError as error:
            raise FileError(f"{file} cannot be opened: {error.strerror}") from error
    return next(kind for kind in FORMATS if kind.recognises(file, head))


def _found(
    path: str | os.PathLike[str], wanted: Wanted
) -> tuple[Path, StreamFormat, Sequence[RawRecording]]:
    """A file, its format, and its streams; columns and names where it has such."""
    file = Path(path)
    kind = format_of(file)
    if wanted.columns and not kind.has_columns:
        raise InputError(f"{file.name} has no columns: leave the column map out")
    if wanted.name is not None and not kind.word:
        raise InputError(
            f"{file.name} has no transform or topic {wanted.name}: leave the name out"
        )
    return file, kind, kind.read(file, wanted)
