"""Other ways to write a recording, turned into the package's own.

Inside, a quaternion is w, x, y, z; a wrench is the force ON the probe and the torque
about the shell's area centroid, both in patient axes. Robots and sensors differ: ROS
writes x, y, z, w; a force sensor reads in the axes of the tool, about the tool's
origin, and often what the probe exerts on the patient.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.errors import InputError
from ttus_opt.probe.trajectory import Trajectory

QUATERNIONS = ("wxyz", "xyzw")
WRENCH_FRAMES = ("patient", "tool")
TORQUE_UNITS = {"Nm": 1.0, "Nmm": 1e-3}


@dataclass(frozen=True)
class Conventions:
    """How a recording is written; the defaults are the package's own.

    Attributes:
        quaternion: Order of the columns ``qw,qx,qy,qz`` as they stand: ``wxyz``, or
            ``xyzw`` where a file of that order carries those names.
        wrench_frame: Axes of force and torque: ``patient`` or ``tool``.
        flip_wrench: Whether the wrench is that of the probe on the patient.
        torque_unit: ``Nm`` or ``Nmm``.
        torque_about: What torques are about: ``centroid`` of the shell, ``origin`` of
            the pose (as CAD and ROS have it), or a point in the probe frame [m].
        wrench_delay: By how much wrenches lag behind poses [s].
    """

    quaternion: str = "wxyz"
    wrench_frame: str = "patient"
    flip_wrench: bool = False
    torque_unit: str = "Nm"
    torque_about: str | tuple[float, float, float] = "centroid"
    wrench_delay: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is not known.

        Raises:
            InputError: An unknown word, or a point or delay that is not finite.
        """
        for name, known in (
            ("quaternion", QUATERNIONS),
            ("wrench_frame", WRENCH_FRAMES),
            ("torque_unit", tuple(TORQUE_UNITS)),
        ):
            if getattr(self, name) not in known:
                raise InputError(
                    f"{name} must be {' or '.join(known)}, got {getattr(self, name)!r}"
                )
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

    @property
    def options(self) -> str:
        """What differs from the package's own, as options of the commands."""
        words = []
        for name, own in asdict(Conventions()).items():
            value = getattr(self, name)
            if value == own:
                continue
            option = f"--{name.replace('_', '-')}"
            if isinstance(value, tuple):
                value = ",".join(map(str, value))
            words.append(option if value is True else f"{option} {value}")
        return " ".join(words)

    def point(self, centroid: Array) -> Array:
        """What torques are about, in the probe frame, shape (3,) [m].

        Args:
            centroid: Area centroid of the shell, probe frame, shape (3,) [m].
        """
        if isinstance(self.torque_about, str):
            return np.zeros(3) if self.torque_about == "origin" else np.array(centroid)
        return np.array(self.torque_about, dtype=np.float64)

    def read(self, recorded: Trajectory, centroid: Array) -> Trajectory:
        """A recording as the package has it.

        Args:
            recorded: With the file's numbers taken at their word.
            centroid: Area centroid of the shell, probe frame, shape (3,) [m].

        Returns:
            The same poses and wrenches by the package's conventions.
        """
        out = recorded
        if self.quaternion == "xyzw":
            out = replace(out, rotation=_reordered(out))
        if out.force is None or out.torque is None:
            return out
        force, torque = out.force, out.torque * TORQUE_UNITS[self.torque_unit]
        if self.wrench_delay:
            force, torque = (
                _advanced(out, values, self.wrench_delay) for values in (force, torque)
            )
        if self.flip_wrench:
            force, torque = -force, -torque
        if self.wrench_frame == "tool":
            force, torque = (
                np.einsum("tij,tj->ti", out.rotation, values)
                for values in (force, torque)
            )
        arm = out.rotation @ (centroid - self.point(centroid))
        return replace(out, force=force, torque=torque - np.cross(arm, force))

    def torque_as_recorded(self, trajectory: Trajectory, centroid: Array) -> Trajectory:
        """Torques about the recording's own point, for what is written or shown.

        Args:
            trajectory: By the package's conventions.
            centroid: Area centroid of the shell, probe frame, shape (3,) [m].
        """
        if trajectory.force is None or trajectory.torque is None:
            return trajectory
        arm = trajectory.rotation @ (centroid - self.point(centroid))
        return replace(
            trajectory, torque=trajectory.torque + np.cross(arm, trajectory.force)
        )


def _reordered(recorded: Trajectory) -> Array:
    """Rotations whose quaternions were read as w, x, y, z and are x, y, z, w."""
    from scipy.spatial.transform import Rotation

    return np.asarray(
        Rotation.from_quat(recorded.quat_wxyz, scalar_first=False).as_matrix()
    )


def _advanced(recorded: Trajectory, values: Array, delay: float) -> Array:
    """Values at later times, linear between frames, within each segment."""
    out = np.empty_like(values)
    for number in np.unique(recorded.segment):
        own = recorded.segment == number
        time = recorded.time[own]
        for c in range(3):
            out[own, c] = np.interp(time + delay, time, values[own, c])
    return out
