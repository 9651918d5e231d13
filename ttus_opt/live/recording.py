"""A session as MCAP: standard messages for viewers, and frames to replay.

Hand, probe, felt and measured wrench are ROS 2 messages (`PoseStamped`,
`WrenchStamped`), which Foxglove, Rerun and ROS open, at `SHOWN` a second. All that the
operator's side was given, and what it let the hand feel, are in the channel `FRAMES`,
from which `ttus_opt.live.replay` renders the same forces again.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import msgspec
import numpy as np

from ttus_opt import example
from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError
from ttus_opt.core.optional import load
from ttus_opt.live.haptic_process import HAND
from ttus_opt.live.haptic_process import SHOWN as REACHED
from ttus_opt.live.messages import Sample
from ttus_opt.live.real_time import OperatorFrame
from ttus_opt.live.safety import is_pose
from ttus_opt.live.simulation import Moment
from ttus_opt.live.subject import N_POINTS
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.pose import to_quaternions

#: Channel of the frames to replay; of the session's description
FRAMES, DESCRIPTION = "/live/frames", "ttus_opt live session"

#: Standard messages a second [1/s]; frame of reference they name
SHOWN, PATIENT = 50.0, "patient"

#: Frames in one message; most points of a recorded probe's shell [–]
BLOCK, MOST_POINTS = 100, 1_000_000

#: Types of ROS 2 of the standard messages
POSE, WRENCH = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/WrenchStamped"

#: The standard channels
CHANNELS = {
    "/hand/pose": POSE,
    "/hand/felt": WRENCH,
    "/probe/pose": POSE,
    "/probe/measured": WRENCH,
}


@dataclass(frozen=True)
class Description:
    """What makes an operator again.

    Attributes:
        probe: Its probe, as `PointShell.from_spec` takes it.
        points: Points of its shell [–].
        comparator: What the hand felt, see `trial.COMPARATORS`.
        epoch: Of that side.
        apart: Whether hand and force were in a process of their own.
    """

    probe: str = example.PROBE
    points: int = N_POINTS
    comparator: str = "model"
    epoch: int = 2
    apart: bool = False

    @property
    def shell(self) -> PointShell:
        """The probe."""
        return PointShell.from_spec(self.probe, n_points=self.points)


class Frame(msgspec.Struct, array_like=True, frozen=True):
    """One step of the operator: what it was given, and what the hand felt.

    Attributes:
        time: Operator's clock [s].
        pose: Rotation (3, 3), then position (3,): 12 float64.
        packets: What had arrived.
        felt: Force, then torque: 6 float64. Of hand and force in a process of their
            own: `haptic_process.HAND` float64 a frame of theirs before the step.
    """

    time: float
    pose: bytes
    packets: list[bytes]
    felt: bytes


class Recorder:
    """Writes a session while it runs; the file appears when it is complete.

    Used in ``with``. Ctrl-C completes it.
    """

    def __init__(
        self, path: str | os.PathLike[str], description: Description | None = None
    ) -> None:
        """Begin a file.

        Args:
            path: The file, ``.mcap``.
            description: What makes the operator again.

        Raises:
            MissingPackageError: mcap or rosbags is not installed.
        """
        types = load("rosbags.typesys", "live")
        self._ros = types.get_typestore(types.Stores.ROS2_HUMBLE)
        self._writer_of = load("mcap.writer", "live").Writer
        self._target = io.replacing(path)
        self._description = description or Description()
        self._block: list[Frame] = []
        self._shown, self._number = -np.inf, 0

    def __enter__(self) -> Self:
        """Open the file."""
        self._opened = contextlib.ExitStack()
        temporary = self._opened.enter_context(self._target)
        file = self._opened.enter_context(temporary.open("wb"))
        self._writer = writer = self._writer_of(file)
        writer.start(profile="ros2", library="ttus_opt")
        writer.add_metadata(
            DESCRIPTION, {"json": json.dumps(asdict(self._description))}
        )
        schemas = {
            kind: writer.register_schema(
                kind, "ros2msg", self._ros.generate_msgdef(kind)[0].encode()
            )
            for kind in (POSE, WRENCH)
        }
        self._channels = {
            name: writer.register_channel(
                topic=name, message_encoding="cdr", schema_id=schemas[kind]
            )
            for name, kind in CHANNELS.items()
        }
        self._frames = writer.register_channel(
            topic=FRAMES, message_encoding="msgpack", schema_id=0
        )
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: Any) -> None:
        """Complete the file, or leave none where there was an error."""
        if kind is not None and not issubclass(kind, KeyboardInterrupt):
            self._opened.__exit__(kind, *error)
            return
        with self._opened:
            self._flush()
            self._writer.finish()

    def watch(self, moment: Moment) -> None:
        """Write a frame of a simulated session."""
        pose = moment.rotation, moment.position
        self._write(moment.time, pose, moment.packets, moment.felt)
        if self._is_due(moment.time):
            self._show(moment.time, pose, moment.felt, moment.sensed)

    def operated(self, frame: OperatorFrame) -> None:
        """Write a frame of an operator whose hand is in a process of its own."""
        felt = np.zeros((0, HAND)) if frame.felt is None else frame.felt
        self._write(frame.time, frame.pose, frame.packets, felt)
        if len(felt) and is_pose(*frame.pose) and self._is_due(frame.time):
            self._show(frame.time, frame.pose, felt[-1][REACHED], frame.measured)

    def _write(
        self,
        now: float,
        pose: tuple[Array, Array],
        packets: Sequence[bytes],
        felt: Array,
    ) -> None:
        numbers = np.concatenate([pose[0].ravel(), pose[1]]).tobytes()
        self._block.append(Frame(now, numbers, list(packets), felt.tobytes()))
        if len(self._block) == BLOCK:
            self._flush()

    def _is_due(self, now: float) -> bool:
        due = now - self._shown >= 1.0 / SHOWN - 1e-9
        if due:
            self._shown = now
        return due

    def _flush(self) -> None:
        if self._block:
            content = msgspec.msgpack.encode(self._block)
            self._add(self._frames, self._block[-1].time, content)
            self._block = []

    def _show(
        self, now: float, pose: tuple[Array, Array], felt: Array, sensed: Sample | None
    ) -> None:
        shown = {"/hand/pose": self._pose(*pose), "/hand/felt": self._wrench(felt)}
        if sensed is not None:
            shown["/probe/pose"] = self._pose(sensed.rotation, sensed.position)
            shown["/probe/measured"] = self._wrench(sensed.wrench)
        split = divmod(round(1e9 * now), 10**9)
        stamp = self._ros_of("builtin_interfaces", "Time", *split)
        header = self._ros_of("std_msgs", "Header", stamp, PATIENT)
        for name, content in shown.items():
            kind = CHANNELS[name]
            message = self._ros.types[kind](header, content)
            self._add(self._channels[name], now, self._ros.serialize_cdr(message, kind))

    def _ros_of(self, package: str, kind: str, *values: object) -> Any:
        """A message of ROS."""
        return self._ros.types[f"{package}/msg/{kind}"](*values)

    def _pose(self, rotation: Array, position: Array) -> Any:
        w, x, y, z = to_quaternions(rotation[None])[0].tolist()
        point = self._ros_of("geometry_msgs", "Point", *position.tolist())
        turn = self._ros_of("geometry_msgs", "Quaternion", x, y, z, w)
        return self._ros_of("geometry_msgs", "Pose", point, turn)

    def _wrench(self, wrench: Array) -> Any:
        force, torque = (
            self._ros_of("geometry_msgs", "Vector3", *part.tolist())
            for part in (wrench[:3], wrench[3:])
        )
        return self._ros_of("geometry_msgs", "Wrench", force, torque)

    @io.signals_deferred()
    def _add(self, channel: int, now: float, content: bytes) -> None:
        stamp = round(1e9 * now)
        self._writer.add_message(channel, stamp, content, stamp, self._number)
        self._number += 1


def frames_of(path: str | os.PathLike[str]) -> tuple[Description, Iterator[Frame]]:
    """Description and frames of a recorded session.

    Raises:
        FileError: Not such a file, or a damaged one.
        MissingPackageError: mcap is not installed.
    """
    reading = load("mcap.reader", "live")
    file = io.existing_file(path, "recorded session")
    try:
        with file.open("rb") as stream:
            described = [
                m.metadata["json"]
                for m in reading.make_reader(stream).iter_metadata()
                if m.name == DESCRIPTION
            ]
        description = msgspec.json.decode(described[0], type=Description)
        if not 0 < description.points <= MOST_POINTS:
            raise ValueError(f"a probe of {description.points} points")
    except Exception as error:
        raise FileError(
            f"{file} is not a session that ttus-opt live has recorded: {error}"
        ) from error
    return description, _frames(file, HAND if description.apart else 6)


def _frames(file: Path, numbers: int) -> Iterator[Frame]:
    """Frames in which the hand felt so many float64, or a multiple of them."""
    reading, size = load("mcap.reader", "live"), 8 * numbers
    decoder = msgspec.msgpack.Decoder(list[Frame])
    with file.open("rb") as stream:
        reader = reading.make_reader(stream, validate_crcs=True)
        found, read = reader.iter_messages(topics=[FRAMES]), 0
        while True:
            try:
                block = next(found, None)
                frames = [] if block is None else decoder.decode(block[2].data)
                if any(len(f.pose) != 96 or len(f.felt) % size for f in frames):
                    raise ValueError("a pose or a wrench of another length")
            except Exception as error:  # whatever mcap and its codecs find
                raise FileError(
                    f"{file} is damaged after {read} frames: "
                    f"{error or type(error).__name__}"
                ) from error
            if block is None:
                return
            yield from frames
            read += len(frames)
