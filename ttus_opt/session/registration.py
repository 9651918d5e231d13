"""Second step of a session: the probe's poses in the patient's frame.

A tracker tells its target's poses in its own frame. From there they go to the scan by a
motion that is known, or that tags give which tracker and scanning camera both saw
(`ttus_opt.sensors.hand_eye`), and on to the patient by the surface's place in the scan.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.errors import InputError
from ttus_opt.probe.rigid_motion import inverse
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.scan.surface import Surface
from ttus_opt.sensors.hand_eye import HandEye, hand_eye, read_pose_pairs
from ttus_opt.sensors.stream_files import read_poses
from ttus_opt.sensors.tool_load import checked_down
from ttus_opt.session.description import Description, Tracker


@dataclass(frozen=True)
class Registration:
    """How the frames lie.

    Attributes:
        tracker_to_scan: Motion, shape (4, 4); None where poses are not the tracker's.
        scan_to_patient: Motion, shape (4, 4).
        tags: How the first was found; None where it was given.
    """

    tracker_to_scan: Array | None = field(repr=False)
    scan_to_patient: Array = field(repr=False)
    tags: HandEye | None = field(repr=False)

    def to_patient(self, frame: str) -> list[Array]:
        """Motions from a frame to the patient's, one after the other.

        Raises:
            InputError: The tracker's place is not known.
        """
        if frame == "patient":
            return []
        if frame == "scan":
            return [self.scan_to_patient]
        if self.tracker_to_scan is None:
            raise InputError(
                "frame tracker is not known here, the poses are said to be in another: "
                "name that one"
            )
        return [self.tracker_to_scan, self.scan_to_patient]

    def facts(self) -> dict[str, Any]:
        """All of it by name with units, for JSON."""
        told: dict[str, Any] = {
            "tracker_to_scan": _listed(self.tracker_to_scan),
            "scan_to_patient": _listed(self.scan_to_patient),
        }
        if self.tags is not None:
            told |= {
                "pairs": self.tags.pairs,
                "solver": self.tags.solver,
                "loop_m": self.tags.loop.gap,
                "loop_degrees": float(np.rad2deg(self.tags.loop.twist)),
                "solvers_differ_m": self.tags.spread,
            }
        return told


def register(tracker: Tracker, surface: Surface) -> Registration:
    """Where the tracker stands.

    Args:
        tracker: As described.
        surface: The patient's, with its place in the scan.

    Raises:
        FileError: The pairs cannot be read.
        InputError: Their loops do not close.
        GeometryError: They turn about one axis only.
    """
    to_scan, found = tracker.to_scan, None
    if tracker.tags is not None:
        tag_in_scan, target_in_tracker = read_pose_pairs(tracker.tags)
        # the scanning camera stands still, and the target carries the tag
        found = hand_eye(tag_in_scan, target_in_tracker, "fixed")
        to_scan = inverse(found.camera)
    return Registration(to_scan, surface.axis.scan_to_patient, found)


def probe_poses(tracker: Tracker, registration: Registration) -> Trajectory:
    """Poses of the probe, patient frame, on the tracker's clock.

    Args:
        tracker: As described.
        registration: Where it stands.

    Raises:
        FileError: The stream cannot be read.
        InputError: A name or columns it does not have.
    """
    stream = tracker.stream
    read = read_poses(stream.file, stream.name, stream.columns)
    motion = tracker.probe_to_target
    probe = Trajectory(
        read.time,
        read.position + read.rotation @ motion[:3, 3],
        read.rotation @ motion[:3, :3],
        segment=read.segment,
    )
    return probe.transformed(*registration.to_patient(tracker.frame))


def gravity(session: Description, registration: Registration) -> Array:
    """Direction of gravity, patient frame, shape (3,).

    Raises:
        InputError: No direction, or in a frame that is not known.
    """
    force = session.force
    assert force.down is not None, "raw readings have one"
    direction = checked_down(force.down)
    for motion in registration.to_patient(force.down_frame):
        direction = motion[:3, :3] @ direction
    return direction


def _listed(motion: Array | None) -> list[list[float]] | None:
    return None if motion is None else motion.tolist()
