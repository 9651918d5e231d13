"""``ttus-opt synchronise``: poses and wrenches of two clocks as one trajectory."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ttus_opt.cli.console import tell
from ttus_opt.cli.options import check_outputs
from ttus_opt.core.errors import InputError

if TYPE_CHECKING:
    from ttus_opt.probe.trajectory import Trajectory
    from ttus_opt.sensors.clock import Offset
    from ttus_opt.sensors.streams import WrenchStream


def synchronise(
    poses: Annotated[Path, typer.Argument()],
    wrenches: Path,
    output: Path,
    by: str | None = None,
    offset: float | None = None,
    surface: Path | None = None,
    transform: str | None = None,
    columns: Annotated[str, typer.Option(metavar="NAME=COLUMN,…|FILE")] = "",
    wrench_columns: Annotated[str, typer.Option(metavar="NAME=COLUMN,…|FILE")] = "",
    pose_topic: str | None = None,
    wrench_topic: str | None = None,
    together: bool = False,
    largest_offset: float = 5.0,
    largest_gap: float = 0.1,
    force: bool = False,
    json: bool = False,
) -> None:
    """Resample wrenches at the times of poses, after aligning both clocks.

    Frames without wrenches are left out; a new segment begins after them.

    Args:
        poses: Trajectory CSV, netCDF, PLUS sequence (.mha), or ROS recording (.bag,
            .mcap, folder).
        wrenches: Table t,fx,fy,fz[,tx,ty,tz] on its own clock, netCDF, or ROS
            recording.
        output: Trajectory CSV.
        by: How to find the offset. contact: the times of contact in forces and poses
            (needs --surface). angular-speed: of the poses and of those in the wrenches'
            file.
        offset: Known offset, added to the wrenches' times [s].
        surface: Surface file (.nc), in the poses' frame.
        transform: Name of the transform, if a .mha file has several, for instance
            ProbeToTracker.
        columns: Column names of the poses' file, or a YAML file of them.
        wrench_columns: Column names of the wrenches' file, or a YAML file of them.
        pose_topic: Topic of the poses, if a ROS recording has several.
        wrench_topic: Topic of the wrenches, if a ROS recording has several.
        together: Both recordings began at about the same time.
        largest_offset: Largest offset to search [s].
        largest_gap: Longer gaps are not interpolated [s].

    Example:
        ttus-opt synchronise tracker.mha --wrenches sensor.csv --by contact --surface
        surface.nc -o recording.csv
    """
    from ttus_opt.sensors.column_map import read_column_map
    from ttus_opt.sensors.stream_files import read_poses, read_wrenches
    from ttus_opt.sensors.streams import with_wrenches

    inputs = [poses, wrenches, *([surface] if surface else [])]
    check_outputs([output], inputs, force=force)
    if (by is None) == (offset is None):
        raise InputError("give either --by contact or angular-speed, or --offset")
    named = read_column_map(wrench_columns)
    track = read_poses(poses, transform or pose_topic, read_column_map(columns))
    stream = read_wrenches(wrenches, wrench_topic, named)
    found = None
    if by is not None:
        around = float(track.time[0] - stream.time[0]) if together else 0.0
        search = (around, largest_offset)
        robot = None
        if by == "angular-speed":
            robot = read_poses(wrenches, columns=named)
        found = _found(track, robot or stream, by, surface, search)
        offset = found.seconds
    assert offset is not None
    joined = with_wrenches(track, stream, offset, largest_gap=largest_gap)
    joined.save(output)
    segments = len(set(joined.segment.tolist()))
    facts = {
        "output": str(output),
        "frames": len(joined),
        "left_out": len(track) - len(joined),
        "segments": segments,
        "offset_s": offset,
        "offset_std_s": None if found is None else found.std,
        "correlation": None if found is None else found.correlation,
        "rival": None if found is None else found.rival,
    }
    how = (
        " s"
        if found is None
        else f" ± {found.std:.4f} s, correlation {found.correlation:.3f}"
    )
    line = (
        f"{output}: {len(joined)} of {len(track)} frames in {segments} segments, "
        f"wrenches moved by {offset:.4f}{how}"
    )
    tell(facts, line, json=json)


def _found(
    track: Trajectory,
    other: WrenchStream | Trajectory,
    by: str,
    surface: Path | None,
    search: tuple[float, float],
) -> Offset:
    """The offset by contact with forces, or by angular speed with other poses."""
    from ttus_opt.probe.trajectory import Trajectory
    from ttus_opt.scan.surface import Surface
    from ttus_opt.sensors import clock
    from ttus_opt.sensors.angular_offset import angular_offset

    around, largest = search
    if isinstance(other, Trajectory):
        return angular_offset(track, other, around=around, largest=largest)
    if by == "contact":
        if surface is None:
            raise InputError("--by contact needs --surface, in the frame of the poses")
        second = clock.contact_of_force(other.time, other.force)
        share = float(second.values.mean())
        first = clock.contact_of_poses(track, Surface.load(surface), share)
    else:
        raise InputError(f"--by takes contact or angular-speed, got {by!r}")
    return clock.clock_offset(first, second, around=around, largest=largest)
