"""Pose and wrench streams of different rates, joined at the times of the poses.

Rotations are interpolated by slerp, all else linearly, and nothing across a gap: frames
in it are left out, and a new segment begins after it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ttus_opt.core.arguments import expect_positive
from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.core.errors import FileError, InputError, located
from ttus_opt.probe.raw_recording import RawRecording
from ttus_opt.probe.recording_faults import checked
from ttus_opt.probe.text_table import read_text_table
from ttus_opt.probe.trajectory import Trajectory, interpolated
from ttus_opt.probe.trajectory_csv import FORCE, recording_of

#: Larger readings are refused [N, N·m]
LARGEST = 1e5


@dataclass(frozen=True)
class WrenchStream:
    """Readings of a force sensor on its own clock.

    Attributes:
        time: Increasing, shape (T,) [s].
        force: Shape (T, 3) [N].
        torque: Shape (T, 3) [N·m]; None where not measured.
    """

    time: Array
    force: Array = field(repr=False)
    torque: Array | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        """Validate the readings.

        Raises:
            InputError: No readings, not finite, or times that do not increase.
        """
        n = len(self.time)
        if n < 2:
            raise InputError(f"a stream of wrenches needs at least 2 readings, got {n}")
        shapes = {"time": (n,), "force": (n, 3), "torque": (n, 3)}
        for name, shape in shapes.items():
            values = getattr(self, name)
            if values is None:
                continue
            if values.shape != shape or not np.isfinite(values).all():
                raise InputError(f"{name} of a stream must be finite, shape {shape}")
            if name != "time" and np.abs(values).max() > LARGEST:
                raise InputError(f"{name} of a stream exceeds {LARGEST:g}: counts?")
        if not (np.diff(self.time) > 0).all():
            raise InputError(
                "times of a stream must increase [s]: sort them, drop duplicates"
            )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the table that `ttus_opt.sensors.stream_files.read_wrenches` reads.

        Raises:
            FileError: The file cannot be written.
        """
        recorded = RawRecording("", self.time, force=self.force, torque=self.torque)
        recorded.save(path)


def raw_wrenches(file: Path, columns: Mapping[str, str] | None = None) -> RawRecording:
    """Wrenches without poses, of a table ``t,fx,fy,fz[,tx,ty,tz]``, as it has them.

    Raises:
        FileError: Damaged, or without such columns.
    """
    return recording_of(read_text_table(file, ("t", *FORCE), columns), "", FORCE)


def wrenches_of(raw: RawRecording) -> WrenchStream:
    """The wrenches of a recording, checked.

    Raises:
        FileError: Anything is wrong with it, or it has none.
    """
    if raw.force is None:
        raise FileError(f"{raw.title} has no forces")
    read = checked(raw.replaced(position=None, quaternion=None))
    assert read.force is not None
    with located(read.title, FileError):
        return WrenchStream(read.time, read.force, read.torque)


def with_wrenches(
    poses: Trajectory, wrenches: WrenchStream, offset: float, *, largest_gap: float
) -> Trajectory:
    """Poses with the wrenches at their times; frames without a wrench are left out.

    Args:
        poses: On the first clock; any wrenches of their own are replaced.
        wrenches: On the second clock.
        offset: Seconds to add to the second clock [s], see `clock_offset`.
        largest_gap: Longest time between readings that is interpolated over; a longer
            time between poses begins a new segment [s].

    Raises:
        InputError: The streams do not overlap, or an invalid gap.
    """
    if not (np.isfinite(offset) and 0.0 < largest_gap < np.inf):
        raise InputError(
            "offset and largest gap must be finite [s], the gap positive, got "
            f"{offset} and {largest_gap}"
        )
    time = wrenches.time + offset
    keep = within(poses.time, time, largest_gap)
    if not keep.any():
        raise InputError(
            f"poses from {poses.time[0]:.6g} to {poses.time[-1]:.6g} s have no "
            f"wrenches; these run from {time[0]:.6g} to {time[-1]:.6g} s: check the "
            "offset"
        )
    out = poses.select(keep)
    cut = (np.diff(out.time) > largest_gap) | (np.diff(out.segment) != 0)
    force, torque = (
        None if values is None else interpolated(out.time, time, values)
        for values in (wrenches.force, wrenches.torque)
    )
    return replace(out, force=force, torque=torque, segment=_parted(keep, cut))


def placed(poses: Trajectory, at: Array) -> tuple[Array, Array]:
    """Rotations (n, 3, 3) and positions (n, 3) [m] at times within those of poses."""
    turns = Slerp(poses.time, Rotation.from_matrix(poses.rotation))(at)
    return turns.as_matrix(), interpolated(at, poses.time, poses.position)


def poses_at(poses: Trajectory, time: Array, *, largest_gap: float) -> Trajectory:
    """Poses interpolated at other times, without wrenches.

    Args:
        poses: One recording.
        time: Increasing, shape (n,) [s].
        largest_gap: Longest time between poses that is interpolated over [s].

    Returns:
        Frames at the times that lie between two poses; a new segment begins after
        every time left out.

    Raises:
        InputError: No time lies between two poses, or an invalid gap.
    """
    expect_positive(largest_gap, "the largest gap", "s")
    if len(poses) < 2 or len(np.unique(poses.segment)) > 1:
        raise InputError("interpolation needs 2 or more poses of one segment: split it")
    keep = within(time, poses.time, largest_gap)
    if not keep.any():
        raise InputError(
            f"no time from {time[0]:.6g} to {time[-1]:.6g} s lies between poses from "
            f"{poses.time[0]:.6g} to {poses.time[-1]:.6g} s: check the offset"
        )
    at = time[keep]
    rotation, position = placed(poses, at)
    # two kept times with a gap between them belong to different segments
    holes = poses.time[:-1][np.diff(poses.time) > largest_gap]
    new = np.diff(np.searchsorted(holes, at)) != 0
    return Trajectory(at, position, rotation, segment=_parted(keep, new))


def _parted(keep: Mask, new: Mask) -> IntArray:
    """Segments of kept frames, new where told and after what was left out."""
    new = new | (np.diff(np.flatnonzero(keep)) > 1)
    return np.concatenate([[0], np.cumsum(new)]).astype(np.int64)


def within(time: Array, known: Array, largest_gap: float) -> Mask:
    """Mask of the times that lie between two known ones at most a gap apart."""
    after = np.clip(np.searchsorted(known, time), 1, len(known) - 1)
    near = known[after] - known[after - 1] <= largest_gap
    return np.asarray((time >= known[0]) & (time <= known[-1]) & near)
