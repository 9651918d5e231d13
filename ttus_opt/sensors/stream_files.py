"""Readers of pose and wrench streams, chosen by the kind of file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from ttus_opt.core.errors import InputError
from ttus_opt.probe.trajectory import Trajectory, read_trajectory
from ttus_opt.sensors.column_map import table_columns
from ttus_opt.sensors.netcdf_stream import read_netcdf_poses, read_netcdf_wrenches
from ttus_opt.sensors.plus_sequence import read_plus_sequence
from ttus_opt.sensors.ros_bag import read_bag_poses, read_bag_wrenches
from ttus_opt.sensors.streams import WrenchStream, read_wrench_stream

NETCDF = (".nc", ".nc4", ".cdf")


def read_poses(
    path: str | os.PathLike[str],
    name: str | None = None,
    columns: Mapping[str, str] | None = None,
) -> Trajectory:
    """Poses: a table, netCDF, a PLUS sequence (``.mha``) or a ROS recording.

    Args:
        path: The file, or the folder of a ROS 2 recording.
        name: The transform or topic, where there are several.
        columns: The file's names, by the package's (`read_column_map`).

    Raises:
        FileError: The file cannot be read.
        InputError: Such a file has no names or no columns.
    """
    file = Path(path)
    if _of_ros(file):
        _require_none(file, columns=columns)
        return read_bag_poses(file, name)
    if file.suffix.lower() == ".mha":
        _require_none(file, columns=columns)
        return read_plus_sequence(file, name)
    _require_none(file, name=name)
    if file.suffix.lower() in NETCDF:
        return read_netcdf_poses(file, columns)
    return read_trajectory(file, columns=_of(columns, "pq"))


def read_wrenches(
    path: str | os.PathLike[str],
    name: str | None = None,
    columns: Mapping[str, str] | None = None,
) -> WrenchStream:
    """Wrenches: a table, netCDF or a ROS recording.

    Args:
        path: The file, or the folder of a ROS 2 recording.
        name: The topic, where there are several.
        columns: As `read_poses`.

    Raises:
        FileError: The file cannot be read.
        InputError: Such a file has no names or no columns.
    """
    file = Path(path)
    if _of_ros(file):
        _require_none(file, columns=columns)
        return read_bag_wrenches(file, name)
    _require_none(file, name=name)
    if file.suffix.lower() in NETCDF:
        return read_netcdf_wrenches(file, columns)
    return read_wrench_stream(file, _of(columns, "ft"))


def _of_ros(file: Path) -> bool:
    return file.is_dir() or file.suffix.lower() in (".bag", ".mcap")


def _require_none(
    file: Path, *, name: str | None = None, columns: Mapping[str, str] | None = None
) -> None:
    if columns:
        raise InputError(f"{file.name} has no columns: leave the column map out")
    if name is not None:
        raise InputError(
            f"{file.name} has no transform or topic {name}: leave the name out"
        )


def _of(columns: Mapping[str, str] | None, kinds: str) -> Mapping[str, str] | None:
    """The columns of one stream, from a map for both."""
    own = ("t", "segment", *(f"{kind}{x}" for kind in kinds for x in "wxyz"))
    named = table_columns(columns or {})
    return {ours: theirs for ours, theirs in named.items() if ours in own}
