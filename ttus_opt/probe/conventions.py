"""Recordings in other conventions, converted to the package's own.

In the package a quaternion is w, x, y, z; a wrench is the force ON the probe and the
torque about the shell's area centroid, both in patient axes. Devices differ: ROS writes
x, y, z, w; a robot gives poses in its base frame, a camera in the scan's; a force
sensor reads in the tool's axes, about the tool's origin, and often with opposite sign.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

import numpy as np

from ttus_opt.core.arguments import expect_one_of
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.probe.pose import from_quaternions
from ttus_opt.probe.rigid_motion import Rows, as_rows, composed, inverse, rigid_motion
from ttus_opt.probe.trajectory import Trajectory, interpolated

QUATERNIONS = ("wxyz", "xyzw")
FRAMES = ("patient", "scan", "base")
WRENCH_FRAMES = (*FRAMES, "tool")
TORQUE_UNITS = {"Nm": 1.0, "Nmm": 1e-3}


@dataclass(frozen=True)
class Conventions:
    """The conventions of a recording; the defaults are the package's own.

    Attributes:
        quaternion: Actual order of the columns ``qw,qx,qy,qz``: ``wxyz`` or ``xyzw``.
        frame: Frame of the poses: ``patient``, ``scan`` (of the cloud from which the
            surface was extracted) or ``base`` (of the robot or tracker).
        wrench_frame: Axes of force and torque: one of these or ``tool``; empty for the
            frame of the poses.
        base_to_scan: The rigid motion x_scan = R x_base + t, rows of a matrix (4, 4);
            None where nothing is in the base frame.
        flip_wrench: Whether the wrench is that of the probe on the patient.
        torque_unit: ``Nm`` or ``Nmm``.
        torque_about: Reference point of torques: ``centroid`` of the shell, ``origin``
            of the pose (as in CAD and ROS), or a point in the probe frame [m].
        wrench_delay: Delay of wrenches behind poses [s].
    """

    quaternion: str = "wxyz"
    frame: str = "patient"
    wrench_frame: str = ""
    base_to_scan: Rows | None = None
    flip_wrench: bool = False
    torque_unit: str = "Nm"
    torque_about: str | tuple[float, float, float] = "centroid"
    wrench_delay: float = 0.0

    def __post_init__(self) -> None:
        """Validate the conventions.

        Raises:
            InputError: An unknown word, a point or delay that is not finite, or a
                frame without its motion, or the other way round.
        """
        if not self.wrench_frame:
            object.__setattr__(self, "wrench_frame", self.frame)
        for name, known in (
            ("quaternion", QUATERNIONS),
            ("frame", FRAMES),
            ("wrench_frame", WRENCH_FRAMES),
            ("torque_unit", tuple(TORQUE_UNITS)),
        ):
            expect_one_of(getattr(self, name), known, name)
        self._require_motion()
        about = self.torque_about
        if isinstance(about, str):
            if about not in ("centroid", "origin"):
                raise InputError(
                    f"torque_about must be centroid, origin or x,y,z [m], got {about!r}"
                )
        elif len(about) != 3 or not all(map(math.isfinite, about)):
            raise InputError(f"torque_about must be a point x,y,z [m], got {about}")
        if not math.isfinite(self.wrench_delay):
            raise InputError(
                f"wrench_delay must be finite [s], got {self.wrench_delay}"
            )

    def _require_motion(self) -> None:
        """Check that ``base_to_scan`` is given exactly where it is needed."""
        in_base = "base" in (self.frame, self.wrench_frame)
        if in_base != (self.base_to_scan is not None):
            raise InputError(
                "frame base needs base_to_scan, the rigid motion from base to scan"
                if in_base
                else "base_to_scan is for recordings in the base's frame: frame is "
                f"{self.frame}, give base"
            )
        if self.base_to_scan is not None:
            checked = rigid_motion(self.base_to_scan)
            object.__setattr__(self, "base_to_scan", as_rows(checked))

    @property
    def options(self) -> str:
        """Differences from the package's conventions, as command-line options."""
        words = []
        usual = {**asdict(Conventions()), "wrench_frame": self.frame}
        for name, own in usual.items():
            value = getattr(self, name)
            if value == own or (name, value) == ("frame", "base"):
                continue  # base_to_scan says so
            option = f"--{name.replace('_', '-')}"
            if name == "base_to_scan":
                value = "…"  # as it was given: a file or numbers
            if isinstance(value, tuple):
                value = ",".join(f"{v:g}" for v in value)
            words.append(option if value is True else f"{option} {value}")
        return " ".join(words)

    def point(self, centroid: Array) -> Array:
        """Reference point of torques, probe frame, from the centroid, (3,) each [m]."""
        if isinstance(self.torque_about, str):
            return np.zeros(3) if self.torque_about == "origin" else np.array(centroid)
        return np.array(self.torque_about, dtype=np.float64)

    def read(
        self,
        recorded: Trajectory,
        centroid: Array,
        scan_to_patient: Array | None = None,
    ) -> Trajectory:
        """The recording in the package's conventions.

        Args:
            recorded: The recording as read from the file, without conversion.
            centroid: Area centroid of the shell, probe frame, shape (3,) [m].
            scan_to_patient: Rigid motion, shape (4, 4); `Axis.scan_to_patient` of the
                surface. None where all is in the patient's frame.

        Raises:
            InputError: A frame without its motion, or a delay beyond the recording.
        """
        span = float(np.ptp(recorded.time))
        if recorded.has_wrench and abs(self.wrench_delay) > span:
            raise InputError(
                f"a wrench_delay of {self.wrench_delay:g} s is longer than the "
                f"recording, {span:.3g} s: give it in seconds, 0 for none"
            )
        out = recorded
        if self.quaternion == "xyzw":
            # they were read as w, x, y, z
            out = replace(out, rotation=from_quaternions(out.quat_wxyz, "xyzw"))
        force, torque = out.force, out.torque
        poses = replace(out, force=None, torque=None)
        poses = poses.transformed(*self._to_patient(self.frame, scan_to_patient))
        if force is None:
            return poses
        turn = self._wrench_turn(poses, scan_to_patient)
        force = self._wrench(out, force, turn)
        if torque is None:
            return replace(poses, force=force)
        torque = TORQUE_UNITS[self.torque_unit] * self._wrench(out, torque, turn)
        arm = poses.rotation @ (centroid - self.point(centroid))
        return replace(poses, force=force, torque=torque - np.cross(arm, force))

    def _wrench(self, recorded: Trajectory, values: Array, turn: Array) -> Array:
        """Measured vectors at the times of the poses, on the probe, patient axes."""
        if self.wrench_delay:
            values = _advanced(recorded, values, self.wrench_delay)
        sign = -1.0 if self.flip_wrench else 1.0
        return np.asarray(sign * np.einsum("...ij,...j->...i", turn, values))

    def _wrench_turn(self, poses: Trajectory, scan_to_patient: Array | None) -> Array:
        """Rotation from the wrench's axes to the patient's, (3, 3) or (T, 3, 3)."""
        if self.wrench_frame == "tool":
            return poses.rotation
        motions = self._to_patient(self.wrench_frame, scan_to_patient)
        return composed(motions)[:3, :3]

    def _to_patient(self, frame: str, scan_to_patient: Array | None) -> list[Array]:
        """Rigid motions from a frame to the patient's, to be applied in order."""
        if frame == "patient":
            return []
        if scan_to_patient is None:
            raise InputError(
                f"frame {frame} needs the surface's place in the scan: "
                "read(..., surface.axis.scan_to_patient)"
            )
        if frame == "scan":
            return [scan_to_patient]
        return [np.array(self.base_to_scan), scan_to_patient]

    def as_recorded(
        self,
        trajectory: Trajectory,
        centroid: Array,
        scan_to_patient: Array | None = None,
    ) -> Trajectory:
        """Poses and wrenches in the recording's frame and about its reference point.

        For output that is compared with the recording. Forces are on the probe, in the
        frame of the poses; torques are in N·m.

        Args:
            trajectory: In the package's conventions.
            centroid: Area centroid of the shell, probe frame, shape (3,) [m].
            scan_to_patient: As in `read`.
        """
        out = trajectory
        if out.force is not None and out.torque is not None:
            arm = out.rotation @ (centroid - self.point(centroid))
            out = replace(out, torque=out.torque + np.cross(arm, out.force))
        motions = self._to_patient(self.frame, scan_to_patient)
        return out.transformed(*(inverse(motion) for motion in reversed(motions)))


def _advanced(recorded: Trajectory, values: Array, delay: float) -> Array:
    """Values at later times, linear between frames, within each segment."""
    out = np.empty_like(values)
    for own in recorded.parts:
        time = recorded.time[own]
        out[own] = interpolated(time + delay, time, values[own])
    return out
