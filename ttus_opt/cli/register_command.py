"""``ttus-opt register``: markers in a photo, and where a camera is."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ttus_opt.cli.console import Stages, tell
from ttus_opt.core.errors import counted

if TYPE_CHECKING:
    from ttus_opt.core.arrays import Array
    from ttus_opt.sensors.marker_pose import MarkerPose


def board(
    image: Annotated[Path, typer.Argument()],
    intrinsics: Path,
    dictionary: str,
    columns: int,
    rows: int,
    marker: float,
    gap: float,
    output: Path | None = None,
) -> None:
    """Find the pose of a board of ArUco or AprilTag markers in a photo.

    Args:
        image: Photo, PNG or JPEG.
        intrinsics: Camera matrix and distortion, JSON or YAML (OpenCV, ROS).
        dictionary: Name of the dictionary in OpenCV: 4X4_250, APRILTAG_36H11, …
        columns: Number of markers in a row.
        rows: Number of rows of markers.
        marker: Side of a marker [m].
        gap: Distance between two markers [m].
        output: Write the motion here, a matrix as JSON.

    Example:
        ttus-opt register board photo.png --intrinsics camera.yaml --dictionary 4X4_250
        --columns 3 --rows 4 --marker 0.0256 --gap 0.0066 -o board_to_camera.json
    """
    from ttus_opt.probe.rigid_motion import write_rigid_motion
    from ttus_opt.sensors.intrinsics import read_intrinsics
    from ttus_opt.sensors.marker_pose import Board, board_pose, read_image

    grid = Board(columns, rows, marker, gap, dictionary)
    camera = read_intrinsics(intrinsics)
    found = board_pose(read_image(image), grid, camera)
    if output is not None:
        write_rigid_motion(output, found.pose)
    facts = {"output": output and str(output), "board_to_camera": _facts(found)}
    tell(facts, f"board to camera: {_sentence(found)}")


def markers(
    image: Annotated[Path, typer.Argument()],
    intrinsics: Path,
    dictionary: str,
    marker: float,
) -> None:
    """Find the poses of single ArUco or AprilTag markers in a photo.

    Args:
        image: Photo, PNG or JPEG.
        intrinsics: Camera matrix and distortion, JSON or YAML (OpenCV, ROS).
        dictionary: Name of the dictionary in OpenCV: 4X4_250, APRILTAG_36H11, …
        marker: Side of a marker [m].

    Example:
        ttus-opt register markers photo.png --intrinsics camera.yaml --dictionary
        APRILTAG_36H11 --marker 0.065
    """
    from ttus_opt.sensors.intrinsics import read_intrinsics
    from ttus_opt.sensors.marker_pose import marker_poses, read_image

    camera = read_intrinsics(intrinsics)
    found = marker_poses(read_image(image), marker, dictionary, camera)
    facts = {"markers_to_camera": [_facts(pose) for pose in found]}
    lines = [f"marker {p.markers[0]} to camera: {_sentence(p)}" for p in found]
    tell(facts, *lines)


def hand_eye(
    pairs: Annotated[Path, typer.Argument()],
    camera: str,
    output: Path | None = None,
    largest_gap: float = 0.010,
    largest_twist: float = 1.0,
) -> None:
    """Find where a camera is from pairs of poses, by seven solvers.

    The result is the motion from camera to base (fixed) or from camera to hand
    (moving), checked by how well the loops of motions close. A tracker counts as a
    camera, and whatever carries its target as a hand.

    Args:
        pairs: Pairs of poses, JSON or NPY (n, 2, 4, 4): marker to camera, hand to base
            [m].
        camera: fixed: the camera stands still, the hand holds the marker; moving: the
            hand holds the camera.
        output: Write the motion here, a matrix as JSON.
        largest_gap: Refuse loops that close worse than this [m].
        largest_twist: Refuse loops that close worse than this [degrees].

    Example:
        ttus-opt register hand-eye pairs.json --camera fixed -o camera_to_base.json
    """
    import numpy as np

    from ttus_opt.probe.rigid_motion import write_rigid_motion
    from ttus_opt.sensors import hand_eye as calibration

    in_camera, in_base = calibration.read_pose_pairs(pairs)
    with Stages(1) as begin:
        begin("comparing solvers")
        found = calibration.hand_eye(
            in_camera,
            in_base,
            camera,  # type: ignore[arg-type]  # checked there
            largest_gap=largest_gap,
            largest_twist=float(np.deg2rad(largest_twist)),
        )
    if output is not None:
        write_rigid_motion(output, found.camera)
    name = "camera_to_base" if camera == "fixed" else "camera_to_hand"
    solvers, lines = {}, []
    for solver in calibration.SOLVERS:
        one = found.candidates.get(solver)
        loop = calibration.Loop(np.inf, np.inf, np.inf) if one is None else one.loop
        gap, turn = loop.gap, np.rad2deg(loop.twist)
        position = None if one is None else one.camera[:3, 3]
        solvers[solver] = {"position": position, "loop_m": gap, "loop_degrees": turn}
        place = "no answer" if one is None else _place(one.camera)
        lines.append(f"{solver:<11} {place}, loop {1e3 * gap:.2f} mm {turn:.3f}°")
    facts = {
        "output": output and str(output),
        name: found.camera,
        "pairs": found.pairs,
        "solver": found.solver,
        **found.loop.facts(),
        "spread_m": found.spread,
        "solvers": solvers,
    }
    lines.append(
        f"{name.replace('_', ' ')} by {found.solver}: {found.pairs} pairs, loops "
        f"{found.loop} on average, solvers differ by {1e3 * found.spread:.2f} mm; read "
        "as marker to camera and hand to base"
    )
    tell(facts, *lines)


def _place(pose: Array) -> str:
    return "({:.4f}, {:.4f}, {:.4f}) m".format(*pose[:3, 3])


def _sentence(found: MarkerPose) -> str:
    import numpy as np

    shift = " ".join(f"{1e3 * v:.2f}" for v in found.shift_std)
    turn = " ".join(f"{np.rad2deg(v):.2f}" for v in found.turn_std)
    return (
        f"{_place(found.pose)} ± ({shift}) mm, ± ({turn})°, "
        f"{counted(len(found.markers), 'marker')}, corners within "
        f"{found.residual:.2f} pixels"
    )


def _facts(found: MarkerPose) -> dict[str, Any]:
    return {
        "markers": list(found.markers),
        "pose": found.pose,
        "covariance": found.covariance,
        "residual_pixels": found.residual,
        "other_residual_pixels": found.other_residual,
    }
