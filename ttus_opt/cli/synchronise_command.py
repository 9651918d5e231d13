"""``ttus-opt synchronise``: poses and wrenches of two clocks as one trajectory."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ttus_opt.cli.console import as_options, tell
from ttus_opt.cli.options import check_outputs
from ttus_opt.core.errors import InputError, TtusError

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
    stream: Annotated[
        str | None, typer.Option("--stream", "--transform", "--pose-topic")
    ] = None,
    wrench_stream: Annotated[
        str | None, typer.Option("--wrench-stream", "--wrench-topic")
    ] = None,
    columns: Annotated[str, typer.Option(metavar="NAME=COLUMN,…|FILE")] = "",
    wrench_columns: Annotated[str, typer.Option(metavar="NAME=COLUMN,…|FILE")] = "",
    together: bool = False,
    largest_offset: float = 5.0,
    largest_gap: float = 0.1,
    repair: bool = False,
    force: bool = False,
    json: bool = False,
) -> None:
    """Resample wrenches at the times of poses, after aligning both clocks.

    Frames without wrenches are left out; a new segment begins after them.

    Args:
        poses: Poses: a table, netCDF, a sequence of PLUS (.mha, .nrrd), a recording of
            ROS (.bag, .mcap, .db3, folder), NDI, Motive, Vicon or TRC.
        wrenches: Wrenches on their own clock: a table, netCDF, a recording of ROS, or a
            log of ATI's Net F/T.
        output: Trajectory CSV.
        by: How to find the offset. contact: the times of contact in forces and poses
            (needs --surface). angular-speed: of the poses and of those in the wrenches'
            file.
        offset: Known offset, added to the wrenches' times [s].
        surface: Surface file (.nc), in the poses' frame.
        stream: Name of the topic, transform, tool or body, if the poses' file has
            several, for instance ProbeToTracker; of /tf two frames, base:tool.
        wrench_stream: Name of the topic or device, if the wrenches' file has several.
        columns: Column names of the poses' file, or a YAML file of them.
        wrench_columns: Column names of the wrenches' file, or a YAML file of them.
        together: Both recordings began at about the same time.
        largest_offset: Largest offset to search [s].
        largest_gap: Longer gaps are not interpolated [s].
        repair: Drop missing and repeated rows, sort, split at gaps and jumps, and say
            so.

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
    track = read_poses(poses, stream, read_column_map(columns), repair=repair)
    try:
        forces = read_wrenches(wrenches, wrench_stream, named, repair=repair)
    except TtusError as error:
        options = {"name": "--wrench-stream", "columns": "--wrench-columns"}
        raise InputError(as_options(str(error), **options)) from error
    found = None
    if by is not None:
        around = float(track.time[0] - forces.time[0]) if together else 0.0
        search = (around, largest_offset)
        robot = None
        if by == "angular-speed":
            robot = read_poses(wrenches, columns=named, repair=repair)
        found = _found(track, robot or forces, by, surface, search)
        offset = found.seconds
    assert offset is not None
    joined = with_wrenches(track, forces, offset, largest_gap=largest_gap)
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
