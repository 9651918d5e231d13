"""Depth images and intrinsics in recordings of RealSense's SDK and of ROS (``.bag``).

The SDK writes ``/device_0/sensor_0/Depth_0/image/data``, ``…/info/camera_info`` and the
unit of a depth as ``/device_0/sensor_0/option/Depth Units/value`` [m]; a driver of ROS
an image of 16UC1 [mm] or 32FC1 [m] and a camera_info beside it. Of a recording one
image is taken, by default the one in the middle. Needs the extra ``sensors`` (rosbags).
"""

from __future__ import annotations

import posixpath
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.errors import FileError, InputError
from ttus_opt.sensors.ros_bag import opened, reading
from ttus_opt.sensors.stream_format import one_of

SUFFIX = ".bag"

IMAGE, INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"

#: Topic of the SDK's option, a Float32
UNITS = "option/Depth Units/value"

#: Type of a pixel and its unit where none is stated [m], by the image's encoding
ENCODINGS = {"mono16": ("u2", 1e-3), "16UC1": ("u2", 1e-3), "32FC1": ("f4", 1.0)}


class Frame(NamedTuple):
    """Which image of a recording was taken.

    Attributes:
        topic: Its name in the recording.
        number: From 0.
        images: How many the topic has.
        seconds: After the topic's first image [s].
        unit: Of a pixel [m].
    """

    topic: str
    number: int
    images: int
    seconds: float
    unit: float

    @property
    def which(self) -> str:
        """The same without the topic, in words."""
        return (
            f"image {self.number + 1} of {self.images}, {self.seconds:.3g} s after the "
            f"first, in units of {1e3 * self.unit:g} mm"
        )

    def __str__(self) -> str:
        return f"{self.topic}, {self.which}"


def depth_topics(path: Path) -> list[str]:
    """Topics of depth images in a recording, in order.

    Raises:
        FileError: Damaged.
        MissingPackageError: rosbags is not installed.
    """
    with opened(path) as (reader, _):
        return _topics(reader)


def read_bag_depth(
    path: Path, topic: str | None = None, at: float | None = None
) -> tuple[NDArray[Any], Frame]:
    """A depth image of a recording, as recorded, and which one it is.

    Args:
        path: The ``.bag``.
        topic: Name of its images, where there are several.
        at: The image nearest to this time after the first [s]; by default the one in
            the middle.

    Raises:
        FileError: Damaged, without depth images, or with several topics of them.
        InputError: A time outside the recording.
        MissingPackageError: rosbags is not installed.
    """
    with opened(path) as (reader, decode):
        own = _images(path, reader, topic)
        which, raw = _taken(reader, own, at)
        message = decode(raw, IMAGE)
        stated = _option(reader, decode)
    if message.encoding not in ENCODINGS:
        raise FileError(
            f"{path} has images of {message.encoding} in {own[0].topic}: 16 bits are "
            "needed"
        )
    kind, unit = ENCODINGS[message.encoding]
    order = ">" if message.is_bigendian else "<"
    data = np.frombuffer(message.data.tobytes(), np.uint8)
    size = np.dtype(kind).itemsize * message.width
    with reading(path):
        rows = data.reshape(message.height, message.step)
        pixels = np.ascontiguousarray(rows[:, :size]).view(f"{order}{kind}")
    return pixels, Frame(own[0].topic, *which, unit if stated is None else stated)


def read_bag_camera_info(path: Path, topic: str | None = None) -> dict[str, Any]:
    """The depth camera's matrix, distortion and size, by names of ROS.

    Args:
        path: The ``.bag``.
        topic: Name of the images, where there are several.

    Raises:
        FileError: Damaged, or without a camera_info of depth images.
        MissingPackageError: rosbags is not installed.
    """
    with opened(path) as (reader, decode):
        image = _images(path, reader, topic)[0].topic
        own = [c for c in reader.connections if c.msgtype == INFO and _depth(c)]
        if not own:
            raise FileError(f"{path} has no camera_info of depth images: --intrinsics")
        # the one of the images has the most of their name
        own.sort(key=lambda c: -len(posixpath.commonpath([c.topic, image])))
        _, _, raw = next(iter(reader.messages(connections=own[:1])))
        info = decode(raw, INFO)
    return {
        "K": info.K.tolist(),
        "D": info.D.tolist(),
        "width": info.width,
        "height": info.height,
        "distortion_model": info.distortion_model,
    }


def _depth(connection: Any) -> bool:
    return "depth" in connection.topic.lower()


def _images(path: Path, reader: Any, topic: str | None) -> list[Any]:
    """Connections of the topic of depth images."""
    names = _topics(reader)
    if not names:
        topics = ", ".join(sorted(c.topic for c in reader.connections))
        raise FileError(f"{path} has no topic of depth images, but {topics}")
    chosen = one_of(path, names, topic, "topics of depth images")
    return [c for c in reader.connections if c.topic == chosen]


def _topics(reader: Any) -> list[str]:
    own = [c for c in reader.connections if c.msgtype == IMAGE and _depth(c)]
    return sorted({c.topic for c in own if c.msgcount})


def _taken(
    reader: Any, own: list[Any], at: float | None
) -> tuple[tuple[int, int, float], bytes]:
    """The image in the middle, or the one nearest to a time [s].

    Returns:
        Its number, how many there are and its time [s]; its content.
    """
    count = sum(c.msgcount for c in own)
    best, first, seconds = None, None, 0.0
    for number, (_, stamp, raw) in enumerate(reader.messages(connections=own)):
        first = stamp if first is None else first
        seconds = 1e-9 * (stamp - first)
        away = float(abs(number - count // 2)) if at is None else abs(seconds - at)
        if best is not None and away >= best[0]:
            break  # they come in the order of time
        best = away, (number, count, seconds), raw
    assert best is not None
    if at is not None and not 0.0 <= at <= seconds + 1.0 / count:
        raise InputError(
            f"at={at:g} is outside the recording, which has {seconds:.3g} s of depth "
            "images"
        )
    return best[1], best[2]


def _option(reader: Any, decode: Callable[[bytes, str], Any]) -> float | None:
    """The unit that the SDK states [m]."""
    own = [c for c in reader.connections if c.topic.endswith(UNITS)]
    for _, _, raw in reader.messages(connections=own) if own else ():
        value = float(decode(raw, "std_msgs/msg/Float32").data)
        if 0.0 < value < 1.0:
            return value
    return None
