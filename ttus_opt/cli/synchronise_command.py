"""``ttus-opt synchronise``: poses and wrenches of two clocks as one trajectory."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ttus_opt.cli.console import tell
from ttus_opt.cli.options import compared_clocks, told_by
from ttus_opt.core.errors import InputError, counted

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
    frame: str = "",
    base_to_scan: Annotated[str, typer.Option(metavar="FILE|x,y,z,qx,qy,qz,qw")] = "",
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
        surface: Surface file (.nc), for --by contact.
        frame: Frame of the poses: patient (of the surface file), scan (of the cloud it
            was extracted from) or base (of the robot or tracker). By default patient,
            or base with --base-to-scan. The trajectory stays in it.
        stream: Name of the topic, transform, tool or body, if the poses' file has
            several, for instance ProbeToTracker; of /tf two frames, base:tool.
        wrench_stream: Name of the topic or device, if the wrenches' file has several.
        columns: Column names of the poses' file, or a YAML file of them.
        wrench_columns: Column names of the wrenches' file, or a YAML file of them.
        largest_gap: Longer gaps are not interpolated [s].

    Example:
        ttus-opt synchronise tracker.mha --wrenches sensor.csv --by contact --surface
        surface.nc --base-to-scan base_to_scan.txt -o recording.csv
    """
    from ttus_opt.probe.recording_faults import checked
    from ttus_opt.sensors.angular_offset import angular_offset
    from ttus_opt.sensors.column_map import read_column_map
    from ttus_opt.sensors.stream_files import read_poses, read_wrenches
    from ttus_opt.sensors.streams import with_wrenches

    if (by is None) == (offset is None):
        raise InputError("give either --by contact or angular-speed, or --offset")
    if by == "contact" and surface is None:
        raise InputError("--by contact needs --surface")
    if by != "contact" and (frame or base_to_scan):
        raise InputError("--frame and --base-to-scan are for --by contact")
    if by not in (None, "contact", "angular-speed"):
        raise InputError(f"--by takes contact or angular-speed, got {by!r}")
    named = read_column_map(wrench_columns)
    track = read_poses(poses, stream, read_column_map(columns), repair=repair)
    with told_by(name="--wrench-stream", columns="--wrench-columns"):
        forces = read_wrenches(wrenches, wrench_stream, named, repair=repair)
    found = None
    around = float(track.time[0] - forces.time[0]) if together else 0.0
    search = (around, largest_offset)
    if surface is not None and by == "contact":
        found = _by_contact(track, forces, (surface, frame, base_to_scan), search)
    elif by is not None:
        robot = read_poses(wrenches, columns=named, repair=repair)
        with compared_clocks((track.time[0], robot.time[0]), search):
            found = angular_offset(track, robot, around=around, largest=largest_offset)
    offset = found.seconds if offset is None and found is not None else offset
    assert offset is not None
    joined = with_wrenches(track, forces, offset, largest_gap=largest_gap)
    checked(joined.raw(str(wrenches))).save(output)
    segments = len(joined.parts)
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
        f"{output}: {len(joined)} of {len(track)} frames in "
        f"{counted(segments, 'segment')}, wrenches moved by {offset:.4f}{how}"
    )
    tell(facts, line)


def _by_contact(
    track: Trajectory,
    forces: WrenchStream,
    place: tuple[Path, str, str],
    search: tuple[float, float],
) -> Offset:
    """The offset by contact in poses and forces.

    Args:
        track: The poses.
        forces: On their own clock.
        place: Surface, frame of the poses and motion from base to scan, as typed.
        search: Centre and half width of the offsets [s].
    """
    from numpy import zeros

    from ttus_opt.cli.recording_options import RecordingOptions
    from ttus_opt.scan.surface import Surface
    from ttus_opt.sensors.clock import clock_offset, contact_of_force, contact_of_poses

    surface, frame, base_to_scan = place
    advice = "; are --frame and --base-to-scan right?"
    if not (frame or base_to_scan):
        advice = (
            "; poses were read in the patient's frame, otherwise give --frame scan, or "
            "--base-to-scan for a robot's or tracker's"
        )
    with compared_clocks((track.time[0], forces.time[0]), search, advice):
        second = contact_of_force(forces.time, forces.force)
        told = RecordingOptions([], frame=frame, base_to_scan=base_to_scan)
        patient = Surface.load(surface)
        moved = told.conventions.read(track, zeros(3), patient.axis.scan_to_patient)
        first = contact_of_poses(moved, patient, float(second.values.mean()))
        return clock_offset(first, second, around=search[0], largest=search[1])
