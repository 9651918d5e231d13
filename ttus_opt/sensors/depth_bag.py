"""Depth images and intrinsics in recordings of RealSense's SDK and of ROS (``.bag``).

The SDK writes ``/device_0/sensor_0/Depth_0/image/data``, ``…/info/camera_info`` and the
unit of a depth as ``/device_0/sensor_0/option/Depth Units/value`` [m]; a driver of ROS
an image of 16UC1 [mm] or 32FC1 [m] and a camera_info beside it. The frame in the middle
of the recording is taken. Needs the extra ``sensors`` (rosbags).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.errors import FileError, TtusError
from ttus_opt.core.optional import load

T = TypeVar("T")

SUFFIX = ".bag"

IMAGE, INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"

#: Topic of the SDK's option, a Float32
UNITS = "option/Depth Units/value"

#: Type of a pixel and its unit where none is stated [m], by the image's encoding
ENCODINGS = {"mono16": ("u2", 1e-3), "16UC1": ("u2", 1e-3), "32FC1": ("f4", 1.0)}


class BagDepth(NamedTuple):
    """A depth image of a recording.

    Attributes:
        pixels: As recorded, shape (height, width).
        unit: Of a pixel [m].
        frame: Its number, from 0, and how many there are.
    """

    pixels: NDArray[Any]
    unit: float
    frame: tuple[int, int]


def read_bag_depth(path: Path) -> BagDepth:
    """The depth image in the middle of a recording.

    Args:
        path: The ``.bag``.

    Raises:
        FileError: Damaged, or without depth images.
        MissingPackageError: rosbags is not installed.
    """

    def read(reader: Any, known: Any) -> BagDepth:
        own = [c for c in reader.connections if c.msgtype == IMAGE and _depth(c)]
        if not own:
            topics = ", ".join(sorted(c.topic for c in reader.connections))
            raise FileError(f"{path} has no topic of depth images, but {topics}")
        chosen = [c for c in own if c.topic == own[0].topic]
        count = sum(c.msgcount for c in chosen)
        message, content = None, reader.messages(connections=chosen)
        for number, (_, _, raw) in enumerate(content):
            if number == count // 2:
                message = known.deserialize_ros1(raw, IMAGE)
                break
        if message is None or message.encoding not in ENCODINGS:
            kind = "no image" if message is None else f"images of {message.encoding}"
            raise FileError(f"{path} has {kind} in {own[0].topic}: 16 bits are needed")
        kind, unit = ENCODINGS[message.encoding]
        order = ">" if message.is_bigendian else "<"
        data = np.frombuffer(message.data.tobytes(), np.uint8)
        rows = data.reshape(message.height, message.step)
        size = np.dtype(kind).itemsize * message.width
        pixels = np.ascontiguousarray(rows[:, :size]).view(f"{order}{kind}")
        stated = _option(reader, known)
        frame = (count // 2, count)
        return BagDepth(pixels, unit if stated is None else stated, frame)

    return _opened(path, read)


def read_bag_camera_info(path: Path) -> dict[str, Any]:
    """The depth camera's matrix, distortion and size, by names of ROS.

    Raises:
        FileError: Damaged, or without a camera_info of depth images.
        MissingPackageError: rosbags is not installed.
    """

    def read(reader: Any, known: Any) -> dict[str, Any]:
        own = [c for c in reader.connections if c.msgtype == INFO and _depth(c)]
        if not own:
            raise FileError(f"{path} has no camera_info of depth images: --intrinsics")
        _, _, raw = next(iter(reader.messages(connections=own[:1])))
        info = known.deserialize_ros1(raw, INFO)
        return {
            "K": info.K.tolist(),
            "D": info.D.tolist(),
            "width": info.width,
            "height": info.height,
            "distortion_model": info.distortion_model,
        }

    return _opened(path, read)


def _depth(connection: Any) -> bool:
    return "depth" in connection.topic.lower()


def _option(reader: Any, known: Any) -> float | None:
    """The unit that the SDK states [m]."""
    own = [c for c in reader.connections if c.topic.endswith(UNITS)]
    for _, _, raw in reader.messages(connections=own) if own else ():
        value = float(known.deserialize_ros1(raw, "std_msgs/msg/Float32").data)
        if 0.0 < value < 1.0:
            return value
    return None


def _opened(path: Path, read: Callable[[Any, Any], T]) -> T:
    """What a function reads of a recording.

    Raises:
        FileError: It cannot be read.
        MissingPackageError: rosbags is not installed.
    """
    load("rosbags", "sensors")
    rosbag: Any = load("rosbags.rosbag1", "sensors")
    types: Any = load("rosbags.typesys", "sensors")
    known = types.get_typestore(types.Stores.ROS1_NOETIC)
    try:
        with rosbag.Reader(path) as reader:
            return read(reader, known)
    except TtusError:
        raise
    except (Exception, MemoryError) as error:  # damaged files raise nearly every class
        raise FileError(
            f"{path} cannot be read as a recording ({type(error).__name__}): record "
            "or copy it again"
        ) from error
