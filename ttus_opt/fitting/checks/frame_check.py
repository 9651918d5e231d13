"""Are recordings in the stated frame?

A measuring probe is near the skin: recordings that were written in the scan's frame but
read as the patient's usually lie away from it, and near it once they are transformed.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ttus_opt.contact.scene import Scene, ScenePlan
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError, MistakeWarning, TtusWarning, warn
from ttus_opt.probe.conventions import Conventions
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.recording_faults import jumps
from ttus_opt.probe.rigid_motion import as_rows, inverse
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.scan.surface import Surface

#: Distance of a probe's centroid from the skin up to which it is near [m]
NEAR = 0.1

#: Shares of frames near the skin: below the first there is a warning, above the second
#: another frame is suggested [–]
FEW, MANY = 0.2, 0.6


def share_near_skin(
    trajectory: Trajectory, shell: PointShell, surface: Surface
) -> float:
    """Share of frames whose probe is near the skin.

    Args:
        trajectory: Poses in the patient frame.
        shell: The probe.
        surface: The patient's surface.
    """
    points = trajectory.position + trajectory.rotation @ np.asarray(shell.reference)
    radius = np.hypot(points[:, 0], points[:, 1])
    angle, z = np.arctan2(points[:, 1], points[:, 0]), points[:, 2]
    near = np.abs(radius - surface.radius_at(angle, z)) < NEAR
    near &= (z > surface.z[0] - NEAR) & (z < surface.z[-1] + NEAR)
    return float(near.mean())


def warn_of_another_frame(
    as_written: Trajectory,
    read: Trajectory,
    shell: PointShell,
    surface: Surface,
    conventions: Conventions,
) -> None:
    """Warn when recordings lie on the skin in another frame than the stated one.

    Args:
        as_written: The recordings as in the file, without any conversion.
        read: The recordings as converted by ``conventions``.
        shell: The probe.
        surface: The patient's surface.
        conventions: The conventions of the file.
    """
    near = share_near_skin(read, shell, surface)
    if near >= FEW:
        return
    place: Array = surface.axis.scan_to_patient
    poses = replace(as_written, force=None, torque=None)
    for other, where, remedy in _others(conventions):
        share = share_near_skin(other.read(poses, np.zeros(3), place), shell, surface)
        if share > MANY:
            warn(
                f"the recordings lie off the skin in the {conventions.frame} frame, "
                f"but {100 * share:.0f} % of the poses lie near it {where}: {remedy}",
                kind=MistakeWarning,
            )
            return
    if not as_written.has_wrench:  # poses alone may be anywhere
        return
    remedy = "is --base-to-scan right?"
    if conventions.frame != "base":
        remedy = "give --frame scan, or --base-to-scan for a robot's or tracker's"
    warn(
        f"only {100 * near:.0f} % of the poses are within {100 * NEAR:.0f} cm of the "
        f"skin in the {conventions.frame} frame: {remedy}",
        kind=MistakeWarning,
    )


def warn_of_jumps(recorded: Trajectory) -> None:
    """Warn of poses that jump: a step unlike the steps before and after it.

    Args:
        recorded: Poses, in any frame.
    """
    steps = []
    for recording in recorded.recordings:
        at, size = jumps(recording.position, recording.time)
        steps += list(zip(recording.time[at], size[at], strict=True))
    if steps:
        time, size = steps[0]
        others = f", and {len(steps) - 1} more" if len(steps) > 1 else ""
        warn(
            f"the poses jump by {1e3 * size:.0f} mm at {time:.3f} s, "
            f"{time - recorded.time[0]:.3f} s after the first{others}: did the tracker "
            "lose its target or move? leave those frames out; recordings put together "
            "need a column segment",
            2,
            MistakeWarning,
        )


def scene_in_contact(
    plan: ScenePlan,
    surface: Surface,
    shell: PointShell,
    recorded: Trajectory | Sequence[Trajectory],
) -> Scene:
    """A scene whose recordings, if they have forces, touch the patient.

    Args:
        plan: How it is built.
        surface: The patient's surface.
        shell: The probe.
        recorded: The recordings.

    Raises:
        InputError: As in `ScenePlan.build`, or no shell point of any pose is inside the
            patient.
    """
    with warnings.catch_warnings():
        untouched = "the probe touches the patient in none"  # below that is an error
        warnings.filterwarnings("ignore", untouched, TtusWarning)
        scene = plan.build(surface, shell, recorded)
    if scene.trajectory.has_wrench and not scene.touching.any():
        raise InputError(
            f"{untouched} of {len(scene.trajectory)} poses: there is nothing to fit; "
            "check the poses' frame, unit and registration"
        )
    return scene


def _others(conventions: Conventions) -> Iterator[tuple[Conventions, str, str]]:
    """Other frames of the poses, their names in a sentence, and the remedy."""
    if conventions.base_to_scan is not None and conventions.frame == "base":
        back = as_rows(inverse(np.array(conventions.base_to_scan)))
        yield (
            replace(conventions, base_to_scan=back),
            "with the inverse of base_to_scan",
            "x_scan = R x_base + t is expected, give the inverse",
        )
    for frame in ("patient", "scan"):
        if frame != conventions.frame:
            other = replace(
                conventions, frame=frame, wrench_frame="", base_to_scan=None
            )
            remedy = f"read them with --frame {frame}"
            yield other, f"in the {frame} frame", remedy
