"""Recordings of ROS 1 and 2 (``.bag``, a folder, ``.mcap``): poses and wrenches.

Messages are decoded by the types that ROS defines, never by definitions in the file.
Times are those of the headers. Needs the extra ``sensors`` (rosbags).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import (
    FileError,
    InputError,
    MissingPackageError,
    located,
    warn,
)
from ttus_opt.core.optional import load
from ttus_opt.probe.pose import from_quaternions
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.sensors.streams import WrenchStream

PREFIX = "geometry_msgs/msg/"
POSES = ("PoseStamped", "TransformStamped")
WRENCHES = ("WrenchStamped",)

#: Most messages of one topic
MOST_MESSAGES = 5_000_000

#: Positions beyond this are in another unit [m]
LARGEST_SHIFT = 100.0


class _Rows(NamedTuple):
    """Times [s] and numbers of a topic, one row per message."""

    time: Array
    values: Array


def read_bag_poses(
    path: str | os.PathLike[str], topic: str | None = None
) -> Trajectory:
    """Poses of a topic of PoseStamped or TransformStamped.

    Args:
        path: A ``.bag`` or ``.mcap`` file, or the folder of a ROS 2 recording.
        topic: May be left out where there is only one.

    Raises:
        FileError: Missing, damaged, no such topic, or several to choose from.
        MissingPackageError: rosbags is not installed.
    """
    rows = _read(path, topic, POSES, _pose)
    with located(os.fspath(path), FileError):
        if not np.abs(rows.values[:, :3]).max() < LARGEST_SHIFT:
            raise InputError(f"positions beyond {LARGEST_SHIFT:g} m: in millimetres?")
        rotation = from_quaternions(rows.values[:, 3:], "xyzw")
        return Trajectory(rows.time, rows.values[:, :3].copy(), rotation)


def read_bag_wrenches(
    path: str | os.PathLike[str], topic: str | None = None
) -> WrenchStream:
    """Wrenches of a topic of WrenchStamped; arguments and errors as `read_bag_poses`.

    Raises:
        FileError: As `read_bag_poses`.
        MissingPackageError: rosbags is not installed.
    """
    rows = _read(path, topic, WRENCHES, _wrench)
    with located(os.fspath(path), FileError):
        return WrenchStream(
            rows.time, rows.values[:, :3].copy(), rows.values[:, 3:].copy()
        )


def _xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def _pose(message: Any) -> list[float]:
    """Position and quaternion x, y, z, w of either message type."""
    if hasattr(message, "pose"):
        shift, turn = message.pose.position, message.pose.orientation
    else:
        shift, turn = message.transform.translation, message.transform.rotation
    return [*_xyz(shift), *_xyz(turn), turn.w]


def _wrench(message: Any) -> list[float]:
    return [*_xyz(message.wrench.force), *_xyz(message.wrench.torque)]


def _read(
    path: str | os.PathLike[str],
    topic: str | None,
    kinds: tuple[str, ...],
    row: Callable[[Any], list[float]],
) -> _Rows:
    """Messages of a topic as rows, by time, one per time stamp.

    Raises:
        FileError: As `read_bag_poses`.
    """
    place = Path(path)
    if not place.exists():
        raise FileError(f"recording not found: {place}: check the path")
    try:
        rows = _rows(place, topic, kinds, row)
    except (FileError, MissingPackageError):
        raise
    except (Exception, MemoryError) as error:  # damaged files raise nearly every class
        raise FileError(
            f"{place} cannot be read as a ROS recording ({type(error).__name__}): "
            "name a .bag or .mcap file, or the folder of a ROS 2 recording"
        ) from error
    if not (np.isfinite(rows.time).all() and np.isfinite(rows.values).all()):
        raise FileError(f"{place}: messages hold NaN or infinity: record it again")
    time, first = np.unique(rows.time, return_index=True)
    doubled = len(rows.time) - len(time)
    if doubled:
        warn(f"{place.name}: {doubled} messages repeat a time stamp: left out", 2)
    return _Rows(time, rows.values[first])


def _rows(
    place: Path,
    topic: str | None,
    kinds: tuple[str, ...],
    row: Callable[[Any], list[float]],
) -> _Rows:
    load("rosbags", "sensors")
    ros1 = place.suffix == ".bag"
    of_version: Any = load(f"rosbags.rosbag{1 if ros1 else 2}", "sensors")
    types: Any = load("rosbags.typesys", "sensors")
    stores = types.Stores
    known = types.get_typestore(stores.ROS1_NOETIC if ros1 else stores.ROS2_HUMBLE)
    decode = known.deserialize_ros1 if ros1 else known.deserialize_cdr
    with of_version.Reader(place) as reader:
        own = [c for c in reader.connections if c.msgtype in map(PREFIX.__add__, kinds)]
        name = _topic(place, sorted({c.topic for c in own}), topic, kinds)
        time, values = [], []
        chosen = [c for c in own if c.topic == name]
        for connection, _, content in reader.messages(connections=chosen):
            message = decode(content, connection.msgtype)
            stamp = message.header.stamp
            time.append(stamp.sec + 1e-9 * stamp.nanosec)
            values.append(row(message))
            if len(time) > MOST_MESSAGES:
                raise FileError(f"{place} has too many messages of {name}: shorten it")
    if not time:
        raise FileError(f"{place} has no message of {name}: was it published?")
    return _Rows(np.array(time, np.float64), np.array(values, np.float64))


def _topic(
    place: Path, known: list[str], topic: str | None, kinds: tuple[str, ...]
) -> str:
    """The topic to read.

    Raises:
        FileError: No such topic, or several to choose from.
    """
    types = " or ".join(kinds)
    if not known:
        raise FileError(f"{place} has no topic of {types}: record one")
    if topic is None and len(known) > 1:
        raise FileError(f"{place} has several topics of {types}: {', '.join(known)}")
    if topic is not None and topic not in known:
        raise FileError(
            f"{place} has no topic {topic} of {types}: one of {', '.join(known)}"
        )
    return known[0] if topic is None else topic
