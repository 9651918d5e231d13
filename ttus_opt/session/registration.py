"""Second step of a session: the probe's poses in the patient's frame.

A tracker reports its target's poses in its own frame. They are mapped to the scan by a
given motion, or by one found from tags that tracker and scanning camera both saw
(`ttus_opt.sensors.hand_eye`), and on to the patient by the surface's axis.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.probe.rigid_motion import composed, inverse
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.scan.surface import Surface
from ttus_opt.sensors.hand_eye import HandEye, hand_eye, read_pose_pairs
from ttus_opt.sensors.stream_files import read_poses
from ttus_opt.sensors.tool_load import checked_down
from ttus_opt.session.description import Description, Tracker


@dataclass(frozen=True)
class Registration:
    """Motions between the frames.

    Attributes:
        tracker_to_scan: Shape (4, 4); None where poses are not in the tracker's frame.
        scan_to_patient: Shape (4, 4).
        tags: How ``tracker_to_scan`` was found; None where it was given.
    """

    tracker_to_scan: Array | None = field(repr=False)
    scan_to_patient: Array = field(repr=False)
    tags: HandEye | None = field(repr=False)

    def to_patient(self, frame: str) -> list[Array]:
        """Motions from a frame to the patient's, to be applied in order.

        Raises:
            InputError: The tracker's pose is unknown.
        """
        if frame == "patient":
            return []
        if frame == "scan":
            return [self.scan_to_patient]
        if self.tracker_to_scan is None:
            raise InputError(
                "frame tracker is unknown here, because the poses are in another: name "
                "that one"
            )
        return [self.tracker_to_scan, self.scan_to_patient]

    def rotation_to_patient(self, frame: str) -> Array:
        """Rotation from a frame to the patient's, shape (3, 3); errors as above."""
        return composed(self.to_patient(frame))[:3, :3]

    def facts(self) -> dict[str, Any]:
        """The motions by name, with units, for JSON."""
        facts: dict[str, Any] = {
            "tracker_to_scan": self.tracker_to_scan,
            "scan_to_patient": self.scan_to_patient,
        }
        if self.tags is not None:
            facts |= {
                "pairs": self.tags.pairs,
                "solver": self.tags.solver,
                "solvers_differ_m": self.tags.spread,
                **self.tags.loop.facts(),
            }
        return facts


def register(tracker: Tracker, surface: Surface) -> Registration:
    """The motions between the frames.

    Args:
        tracker: Its description.
        surface: Surface of the patient, with its axis in the scan.

    Raises:
        FileError: The pairs cannot be read.
        InputError: Their loops do not close.
        GeometryError: They turn about one axis only.
    """
    to_scan, found = tracker.to_scan, None
    if tracker.tags is not None:
        tag_in_scan, target_in_tracker = read_pose_pairs(tracker.tags)
        # the scanning camera is fixed, and the target carries the tag
        found = hand_eye(tag_in_scan, target_in_tracker, "fixed")
        to_scan = inverse(found.camera)
    return Registration(to_scan, surface.axis.scan_to_patient, found)


def probe_poses(tracker: Tracker, registration: Registration) -> Trajectory:
    """The probe's poses, patient frame and tracker clock; errors as `read_poses`."""
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
        InputError: Not a direction, or in an unknown frame.
    """
    force = session.force
    assert force.down is not None, "raw readings have one"
    turn = registration.rotation_to_patient(force.down_frame)
    return np.asarray(turn @ checked_down(force.down))
