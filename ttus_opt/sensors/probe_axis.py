"""The patient frame from a tracked probe held above the sternum, as in the paper.

The probe is held still in a stated orientation: one of its axes points into the
patient, another to the head. With R the probe's rotation to the scan's frame,

    y = −R (into the patient),   z = R (to the head),   x = y × z,

x to the patient's right, y to the front. The origin lies below the probe on the line
along y: half-way between the skin and the supporting plane, as in a frame found from
the scan, or at a stated depth below the skin.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import GeometryError, InputError
from ttus_opt.probe.held import USUAL, held_axes
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.scan.frame import Axis
from ttus_opt.scan.supporting_plane import SupportingPlane, find_supporting_plane
from ttus_opt.scan.surface import Surface
from ttus_opt.sensors.stream_files import read_poses

#: A probe held still moves and turns less than this [m, rad]
STILL_SHIFT, STILL_TURN = 0.010, float(np.deg2rad(5.0))

#: Points this near to the line below the probe are skin below it [m], and at least this
#: many are needed
BESIDE, LEAST_POINTS = 0.015, 10

#: Least cosine between the probe's direction and the supporting plane's normal [–]
LEAST_UPRIGHT = float(np.cos(np.deg2rad(40.0)))


def axis_from_probe(
    poses: Trajectory,
    cloud: Array,
    *,
    held: tuple[str, str] = USUAL,
    depth: float | None = None,
) -> Axis:
    """The patient frame of a scan from a probe held above the sternum.

    Args:
        poses: Poses of the probe, in the scan's frame; several are averaged.
        cloud: The scan, shape (n, 3) [m].
        held: The probe's axes that point into the patient and to the head: ``x``,
            ``-x``, ``y``, ``-y``, ``z`` or ``-z`` each.
        depth: Depth of the origin below the skin [m]; by default half-way to the
            supporting plane.

    Raises:
        InputError: Unknown or equal axes, an implausible depth, a probe that moved, or
            neither a supporting plane nor a depth.
        GeometryError: No skin below the probe, or it does not point at the supporting
            plane.
    """
    into, head = held_axes(held)
    if depth is not None and not 0.01 <= depth <= 0.3:
        raise InputError(
            f"the origin must be 0.01 to 0.3 m below the skin, got {depth:g}: give "
            "metres"
        )
    rotation, at = _mean_pose(poses)
    inward = rotation @ into
    plane = find_supporting_plane(cloud)
    body = cloud if plane is None else cloud[plane.above(cloud)]
    skin = _skin_below(body, at, inward)
    if depth is None:
        depth = _half_way(plane, at + skin * inward, inward)
    z = rotation @ head
    turn = np.stack([np.cross(-inward, z), -inward, z], axis=1)
    return Axis(at + (skin + depth) * inward, turn, plane)


def read_axis(
    path: str | os.PathLike[str],
    cloud: Array,
    *,
    held: tuple[str, str] = USUAL,
    depth: float | None = None,
) -> Axis:
    """The patient frame of a surface file, or from a probe's recorded poses.

    Args:
        path: A surface (.nc), or poses of a probe held above the sternum in any
            known file, frame of the scan.
        cloud: The scan; ``cloud``, ``held`` and ``depth`` are as in `axis_from_probe`.
        held: Applies to poses only.
        depth: Applies to poses only.

    Raises:
        FileError: The file is neither.
        InputError: As `axis_from_probe`.
        GeometryError: As `axis_from_probe`.
    """
    if Path(path).suffix.lower() == ".nc":
        return Surface.load(path).axis
    return axis_from_probe(read_poses(path), cloud, held=held, depth=depth)


def _mean_pose(poses: Trajectory) -> tuple[Array, Array]:
    """Mean rotation (3, 3) and median position (3,) of a probe held still."""
    turns = Rotation.from_matrix(poses.rotation)
    mean = turns.mean()
    at = np.median(poses.position, axis=0)
    turned = float((mean.inv() * turns).magnitude().max())
    shifted = float(np.linalg.norm(poses.position - at, axis=1).max())
    if turned > STILL_TURN or shifted > STILL_SHIFT:
        raise InputError(
            f"the probe moved by {1e3 * shifted:.0f} mm and {np.rad2deg(turned):.0f}° "
            f"in {len(poses)} poses, expected less than {1e3 * STILL_SHIFT:.0f} mm "
            f"and {np.rad2deg(STILL_TURN):.0f}°: keep only the part where it is held "
            "still"
        )
    return mean.as_matrix(), at


def _skin_below(body: Array, at: Array, inward: Array) -> float:
    """Distance from the probe to the skin along the line into the patient [m]."""
    away = body - at
    along = away @ inward
    beside = np.linalg.norm(away - along[:, None] * inward, axis=1)
    below = along[(beside < BESIDE) & (along > -0.05) & (along < 0.5)]
    if len(below) < LEAST_POINTS:
        raise GeometryError(
            "no skin of the scan lies below the probe: are its poses in the scan's "
            "frame, and do the stated axes point into the patient and to the head?"
        )
    nearest = float(np.percentile(below, 5))
    return float(np.median(below[below < nearest + 0.02]))


def _half_way(plane: SupportingPlane | None, skin: Array, inward: Array) -> float:
    """Half the distance from the skin to the supporting plane along a line [m]."""
    if plane is None:
        raise InputError(
            "the scan shows no plane that the body lies on: give the origin's depth "
            "below the skin (depth)"
        )
    upright = -float(plane.normal @ inward)
    if upright < LEAST_UPRIGHT:
        angle = np.rad2deg(np.arccos(np.clip(upright, -1, 1)))
        raise GeometryError(
            f"the probe's axis into the patient is {angle:.0f}° off the direction to "
            "the plane the body lies on: was another axis meant?"
        )
    return 0.5 * float(plane.height(skin[None])[0]) / upright
