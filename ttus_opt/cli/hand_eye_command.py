"""``ttus-opt hand-eye``: where a camera is, from two streams of poses."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ttus_opt.cli.console import Stages, tell
from ttus_opt.cli.options import compared_clocks, told_by


def hand_eye(
    seen: Annotated[Path, typer.Argument()],
    carried: Annotated[Path, typer.Argument()],
    camera: str,
    inverted: bool = False,
    output: Path | None = None,
    stream: str | None = None,
    hand_stream: str | None = None,
    columns: Annotated[str, typer.Option(metavar="NAME=COLUMN,…|FILE")] = "",
    hand_columns: Annotated[str, typer.Option(metavar="NAME=COLUMN,…|FILE")] = "",
    offset: float | None = None,
    together: bool = False,
    largest_offset: float = 5.0,
    repair: bool = False,
) -> None:
    """Find where a camera or tracker is, from two recordings of one motion.

    Each has its own clock: they are aligned by their angular speeds. Wave the hand for
    half a minute, turning it about all axes by 30° and more, irregularly. Outliers are
    left out, and the result has standard errors; a motion that does not determine it is
    refused.

    Args:
        seen: Poses of the marker in the camera or tracker, any known file.
        carried: Poses of the hand in its base, of a robot or a second tracker.
        camera: fixed: the camera stands still, the hand holds the marker; moving: the
            hand holds the camera.
        inverted: The first file has the camera's poses in the frame of the marker, as a
            map's or SLAM's, not the marker's in the camera.
        output: Write the motion from camera to base (fixed) or hand (moving) here, a
            matrix as JSON.
        stream: Name of the topic, transform, tool or body, if the first file has
            several.
        hand_stream: The same of the second file.
        columns: Column names of the first file, or a YAML file of them.
        hand_columns: The same of the second file.
        offset: Known offset, added to the hand's times [s].

    Example:
        ttus-opt hand-eye tracker.csv robot.bag --hand-stream base:tool0 --camera fixed
        -o camera_to_base.json
    """
    import numpy as np

    from ttus_opt.probe.rigid_motion import write_rigid_motion
    from ttus_opt.sensors.column_map import read_column_map
    from ttus_opt.sensors.stream_files import read_poses
    from ttus_opt.sensors.stream_hand_eye import stream_hand_eye

    with Stages(2) as begin:
        begin("reading")
        first = read_poses(seen, stream, read_column_map(columns), repair=repair)
        with told_by(name="--hand-stream", columns="--hand-columns"):
            named = read_column_map(hand_columns)
            second = read_poses(carried, hand_stream, named, repair=repair)
        begin("clocks, pairs and fit")
        around = float(first.time[0] - second.time[0]) if together else 0.0
        begun, search = (first.time[0], second.time[0]), (around, largest_offset)
        with compared_clocks(begun, search):
            found = stream_hand_eye(
                first,
                second,
                camera,  # type: ignore[arg-type]  # checked there
                inverted=inverted,
                offset=offset,
                around=around,
                largest=largest_offset,
            )
    if output is not None:
        write_rigid_motion(output, found.camera)
    name = "camera_to_base" if camera == "fixed" else "camera_to_hand"
    std, degrees = found.shift_std, float(np.rad2deg(found.turn_std))
    facts = {
        "output": output and str(output),
        name: found.camera,
        "marker": found.marker,
        "covariance_turn_rad_shift_m": found.covariance,
        "position_std_m": std,
        "rotation_std_degrees": degrees,
        "offset_s": found.offset,
        "offset_std_s": found.offset_std,
        "correlation": found.correlation,
        "pairs": found.pairs,
        "left_out": found.outliers,
        **found.loop.facts(),
        "median_loop_m": found.median_gap,
        "median_loop_degrees": float(np.rad2deg(found.median_twist)),
    }
    place = ", ".join(f"{v:.4f}" for v in found.camera[:3, 3])
    spread = " ".join(f"{1e3 * v:.2f}" for v in std)
    tell(
        facts,
        f"{name.replace('_', ' ')}: ({place}) m ± ({spread}) mm, ± {degrees:.3f}°",
        f"{found.pairs} pairs, loops {found.loop} on average, {found.outliers} frames "
        "or pairs left out",
        f"the hand's clock moved by {found.offset:.4f} "
        + (f"± {found.offset_std:.4f} s" if offset is None else "s, as given"),
    )
