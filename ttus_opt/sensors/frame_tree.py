"""The tree of frames that ``/tf`` tells: poses of any frame in any other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError
from ttus_opt.probe.pose import from_quaternions
from ttus_opt.probe.raw_recording import RawRecording
from ttus_opt.probe.rigid_motion import homogeneous, inverse
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.sensors.streams import poses_at

#: Longest time between transforms that is interpolated over [s]
LONGEST_GAP = 0.5


@dataclass
class _Link:
    """A frame's poses in its parent.

    Attributes:
        static: Whether one pose holds for all times.
        time: Stamps [s].
        rows: Positions [m] and quaternions w, x, y, z.
    """

    static: bool
    time: list[float] = field(default_factory=list)
    rows: list[Sequence[float]] = field(default_factory=list)

    def poses(self) -> Trajectory:
        """By time, one for each stamp."""
        time, first = np.unique(np.array(self.time), return_index=True)
        values = np.array(self.rows)[first]
        return Trajectory(
            time, values[:, :3].copy(), from_quaternions(values[:, 3:], "wxyz")
        )

    def at(self, time: Array) -> Array:
        """Poses (T, 4, 4) at times within its own; one, the last, if it is static."""
        poses = self.poses()
        if self.static:
            return homogeneous(poses.rotation[-1:], poses.position[-1:])
        poses = poses_at(poses, time, largest_gap=LONGEST_GAP)
        return homogeneous(poses.rotation, poses.position)


class FrameTree:
    """Transforms by parent and child."""

    def __init__(self) -> None:
        self._links: dict[tuple[str, str], _Link] = {}

    def add(
        self,
        parent: str,
        child: str,
        time: float,
        pose: Sequence[float],
        *,
        static: bool,
    ) -> None:
        """Take a transform: the child's pose in the parent.

        Args:
            parent: Name of the frame.
            child: Name of the frame.
            time: Its stamp [s].
            pose: Position [m] and quaternion w, x, y, z.
            static: Whether it holds for all times.
        """
        key = parent.lstrip("/"), child.lstrip("/")
        link = self._links.setdefault(key, _Link(static))
        link.time.append(time)
        link.rows.append(pose)

    def links(self) -> list[tuple[str, str]]:
        """Parents and children whose transform changes."""
        return [key for key, link in self._links.items() if not link.static]

    def _frames(self) -> list[str]:
        return sorted({name for key in self._links for name in key})

    def advice(self) -> str:
        """How a pose of any frame in any other is read."""
        names = self._frames()
        pair = f"{names[0]}:{names[-1]}"
        return f"any of {', '.join(names)} in any other: name='{pair}'"

    def recording(self, source: str, base: str, frame: str) -> RawRecording:
        """Poses of a frame in another, at the stamps of the link with most of them.

        Args:
            source: The file.
            base: Name of the frame in which the poses are.
            frame: Name of the frame whose poses they are.

        Raises:
            FileError: No path of transforms leads from one to the other, or none of
                them overlap in time.
            InputError: A pose that is none, or no common times.
        """
        path = self._path(base, frame)
        if path is None:
            raise FileError(
                f"{source}: no transforms lead from {base} to {frame}: the frames are "
                f"{', '.join(self._frames()) or 'none'}"
            )
        name = f"{base}:{frame}"
        (link, up), *rest = path
        if not rest and not up:  # as it was sent, faults and all
            values = np.array(link.rows)
            time = np.array(link.time)
            return _recording(source, name, time, values[:, :3], values[:, 3:])
        moving = [link for link, _ in path if not link.static]
        if not moving:
            raise FileError(f"{source}: {frame} does not move in {base}: it is static")
        time = max((link.poses().time for link in moving), key=len)
        for link in moving:
            time = poses_at(link.poses(), time, largest_gap=LONGEST_GAP).time
        motion: Array = np.eye(4)
        for link, up in path:
            step = link.at(time)
            motion = motion @ (inverse(step) if up else step)
        turns = Rotation.from_matrix(motion[:, :3, :3]).as_quat(scalar_first=True)
        return _recording(source, name, time, motion[:, :3, 3].copy(), turns)

    def _path(self, base: str, frame: str) -> list[tuple[_Link, bool]] | None:
        """Links from the base to the frame, and whether each is taken upwards."""
        begin, end = base.lstrip("/"), frame.lstrip("/")
        paths: dict[str, list[tuple[_Link, bool]]] = {begin: []}
        reached = [begin]
        for name in reached:  # which grows, the nearest first
            for key, link in self._links.items():
                for near, other, up in ((*key, False), (*key[::-1], True)):
                    if near == name and other not in paths:
                        paths[other] = [*paths[name], (link, up)]
                        reached.append(other)
        return paths.get(end) or None


def _recording(
    source: str, name: str, time: Array, position: Array, quaternion: Array
) -> RawRecording:
    base, _, frame = name.partition(":")
    return RawRecording(
        source,
        time,
        position,
        quaternion,
        name=name,
        notes=(f"SI, {frame} in {base} by /tf",),
        units_stated=True,
    )
