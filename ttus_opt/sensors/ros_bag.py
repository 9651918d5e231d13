"""Recordings of ROS 1 and 2 (``.bag``, a folder, ``.mcap``, ``.db3``).

Poses of PoseStamped, PoseWithCovarianceStamped, TransformStamped, Odometry and ``/tf``,
wrenches of WrenchStamped. Messages are decoded by the types that ROS defines, never by
definitions in the file. Times are those of the headers. Needs the extra ``sensors``
(rosbags).
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ttus_opt.core import io
from ttus_opt.core.errors import FileError, InputError, TtusError, warn
from ttus_opt.core.optional import load
from ttus_opt.probe.raw_recording import RawRecording
from ttus_opt.sensors.frame_tree import FrameTree
from ttus_opt.sensors.stream_format import StreamFormat, Wanted

SUFFIXES = (".bag", ".mcap", ".db3")

#: Most messages of one topic
MOST_MESSAGES = 5_000_000


def _xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def _pose(position: Any, turn: Any) -> list[float]:
    """Position and quaternion w, x, y, z."""
    return [*_xyz(position), turn.w, *_xyz(turn)]


#: Numbers of a message, by its type
POSES: dict[str, Callable[[Any], list[float]]] = {
    "geometry_msgs/msg/PoseStamped": lambda m: _pose(
        m.pose.position, m.pose.orientation
    ),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: _pose(
        m.pose.pose.position, m.pose.pose.orientation
    ),
    "geometry_msgs/msg/TransformStamped": lambda m: _pose(
        m.transform.translation, m.transform.rotation
    ),
    "nav_msgs/msg/Odometry": lambda m: _pose(
        m.pose.pose.position, m.pose.pose.orientation
    ),
}
WRENCHES: dict[str, Callable[[Any], list[float]]] = {
    "geometry_msgs/msg/WrenchStamped": lambda m: [
        *_xyz(m.wrench.force),
        *_xyz(m.wrench.torque),
    ],
}
#: Types of ``/tf``, of today and of old, and what both hold
TREES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
TREE_FIELDS = "geometry_msgs/TransformStamped[] transforms"

#: Names of a topic of transforms that hold for all times
STATIC = "tf_static"


@contextlib.contextmanager
def reading(place: Path) -> Iterator[None]:
    """Tell in one line what rosbags raises for a recording.

    Raises:
        FileError: Missing, empty or damaged.
    """
    if not place.is_dir():
        io.existing_file(place, "recording")
    try:
        yield
    except TtusError:
        raise
    except (Exception, MemoryError) as error:  # damaged files raise nearly every class
        raise FileError(
            f"{place} cannot be read as a ROS recording ({type(error).__name__}): "
            "damaged, or not closed (rosbag or ros2 bag reindex, mcap recover)? It is "
            "a .bag, .mcap or .db3 file, or a folder of ROS 2"
        ) from error


def _read(place: Path, wanted: Wanted) -> list[RawRecording]:
    """All streams of the wanted kind, those of ``/tf`` last."""
    if place.is_dir() and not (place / "metadata.yaml").exists():
        raise FileError(
            f"{place} is a folder without a recording of ROS 2 (metadata.yaml): name a "
            "file in it"
        )
    types = {} if wanted.kind == "wrenches" else {**POSES}
    if wanted.kind in ("", "wrenches"):
        types |= WRENCHES
    kinds = [*types, *([] if wanted.kind == "wrenches" else TREES)]
    try:
        with reading(place):
            return _streams(place, types, kinds, wanted)
    except InputError as error:
        raise FileError(str(error)) from error


class _Topic(NamedTuple):
    """Messages of a topic: their type, their frame, and stamps [s] before numbers."""

    kind: str
    frame: str
    rows: list[list[float]]

    def recording(self, place: Path, name: str) -> RawRecording:
        """Its stream."""
        values = np.array(self.rows, np.float64)
        time, first, second = values[:, 0].copy(), values[:, 1:4], values[:, 4:]
        kind, frame = self.kind.rpartition("/")[2], self.frame or "an unnamed frame"
        told = (f"SI, {kind} in {frame}",)
        raw = RawRecording(str(place), time, name=name, notes=told, units_stated=True)
        if self.kind in WRENCHES:
            return raw.replaced(force=first, torque=second)
        return raw.replaced(position=first, quaternion=second)


def _streams(
    place: Path,
    types: dict[str, Callable[[Any], list[float]]],
    kinds: list[str],
    wanted: Wanted,
) -> list[RawRecording]:
    topics: dict[str, _Topic] = {}
    tree = FrameTree()
    with opened(place) as (reader, decode):
        own = [c for c in reader.connections if c.msgtype in kinds]
        for connection, _, content in reader.messages(connections=own) if own else ():
            topic, kind = connection.topic, connection.msgtype
            message = decode(content, kind)
            if kind in TREES:
                for each in message.transforms:
                    pose = POSES["geometry_msgs/msg/TransformStamped"](each)
                    link = each.header.frame_id, each.child_frame_id
                    tree.add(*link, _stamp(each), pose, static=topic.endswith(STATIC))
                continue
            rows = topics.setdefault(
                topic, _Topic(kind, message.header.frame_id, [])
            ).rows
            rows.append([_stamp(message), *types[kind](message)])
            if len(rows) > MOST_MESSAGES:
                raise FileError(f"{place} has too many messages of {topic}: shorten it")
    out = [topic.recording(place, name) for name, topic in topics.items()]
    if wanted.name or not wanted.kind or not out:  # a topic is meant before a frame
        links = tree.links()
        pair = (wanted.name or "").split(":")
        if len(pair) == 2 and not any(raw.name == wanted.name for raw in out):
            links = sorted({*links, (pair[0], pair[1])})
        of_tree = [tree.recording(str(place), *link) for link in links]
        if of_tree and not wanted.kind:
            of_tree[0] = of_tree[0].noted(tree.advice())
        out += of_tree
    if wanted.kind:
        out = [_by_time(raw) for raw in out]
    return out


def _stamp(message: Any) -> float:
    stamp = message.header.stamp
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def _by_time(raw: RawRecording) -> RawRecording:
    """Sorted, because messages arrive in any order; one for each time stamp."""
    _, first = np.unique(raw.time, return_index=True)
    doubled = int(np.isfinite(raw.time).sum()) - len(first)
    if doubled > 0:
        warn(f"{raw.title}: {doubled} messages repeat a time stamp: left out", 2)
    return raw.select(first)


@contextlib.contextmanager
def opened(place: Path) -> Iterator[tuple[Any, Callable[[bytes, str], Any]]]:
    """The reader of a recording, and what decodes messages by their type.

    Raises:
        FileError: It cannot be read.
        MissingPackageError: rosbags is not installed.
    """
    load("rosbags", "sensors")
    ros1 = place.suffix.lower() == ".bag"
    types: Any = load("rosbags.typesys", "sensors")
    stores = types.Stores
    known = types.get_typestore(stores.ROS1_NOETIC if ros1 else stores.ROS2_HUMBLE)
    for kind in TREES:  # rosbags knows neither of ROS 1
        if kind not in known.types:
            known.register(types.get_types_from_msg(TREE_FIELDS, kind))
    of_version: Any = load(f"rosbags.rosbag{1 if ros1 else 2}", "sensors")
    with reading(place), of_version.Reader(place) as reader:
        yield reader, known.deserialize_ros1 if ros1 else known.deserialize_cdr


ROS = StreamFormat(
    "recording of ROS",
    lambda file, head: file.is_dir() or file.suffix.lower() in SUFFIXES,
    _read,
    "topic",
)
