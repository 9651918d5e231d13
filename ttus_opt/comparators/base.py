"""The base of every comparator: fitted to recordings, it gives a wrench for every pose.

A comparator is another model of contact forces, on the same data and with the same
interface as the potential field. A new one is a file in this folder with a subclass of
`Comparator`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import ClassVar, NotRequired, Protocol, Self, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from ttus_opt.comparators.contact_geometry import ContactGeometry
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.haptic.renderer import Wrench
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.pose import PoseLike, pose_of, rotations
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.scan.surface import Surface

#: Frames with a smaller measured force are not fitted to [N]
LEAST_FORCE = 0.1


class WrenchSource(Protocol):
    """Anything that gives wrenches along a recording."""

    @property
    def name(self) -> str:
        """For tables."""

    def wrenches(self, trajectory: Trajectory) -> Array:
        """The wrench of every frame, shape (n, 6) [N, N·m]."""


class Given(TypedDict):
    """Constructor arguments of every comparator, as its subclasses pass them on."""

    surface: Surface
    shell: PointShell
    cloud: NotRequired[Array | None]


class Comparator(ABC):
    """A contact model; public methods validate their input, subclasses need not.

    Attributes:
        name: Name for `ttus_opt.comparators.create`.
        summary: Description in one line, with its source.
        needs_fit: Whether `render` needs a `fit` before.
        continuous: Whether the force is continuous in the pose.
        turns: Whether turning the scene about z turns the wrench, to rounding.
        surface: The patient.
        shell: The probe.
        cloud: Points of the surface, patient frame, shape (n, 3) [m].
    """

    name: ClassVar[str] = ""
    summary: ClassVar[str] = ""
    needs_fit: ClassVar[bool] = True
    continuous: ClassVar[bool] = True
    turns: ClassVar[bool] = True

    def __init__(
        self, *, surface: Surface, shell: PointShell, cloud: Array | None = None
    ) -> None:
        self.surface, self.shell = surface, shell
        self.cloud = _checked_cloud(surface, cloud)
        self.fitted = False

    def __repr__(self) -> str:
        state = "fitted" if self.fitted or not self.needs_fit else "not fitted"
        return f"<{self.name}: {state}>"

    @cached_property
    def geometry(self) -> ContactGeometry:
        """The probe, and the surface as a spline."""
        return ContactGeometry(self.surface, self.shell)

    def fit(self, trajectories: Trajectory | Sequence[Trajectory]) -> Self:
        """Fit the parameters to one or several recordings; returns itself.

        Raises:
            InputError: No recording, no forces, no contact, or forces that pull.
        """
        if isinstance(trajectories, Trajectory):
            trajectories = [trajectories]
        recording = Trajectory.concatenate(list(trajectories))
        if recording.force is None:
            raise InputError(
                f"{self.name} is fitted to forces, but the recordings have none: add "
                "columns fx, fy, fz"
            )
        if not (np.linalg.norm(recording.force, axis=1) > LEAST_FORCE).any():
            raise InputError(
                f"{self.name} is fitted to contact, no force is above {LEAST_FORCE} N: "
                "give recordings that touch the patient"
            )
        self._require_contact(recording, recording.force)
        self._fit(recording, recording.force)
        self.fitted = True
        return self

    def render(
        self, rotation: PoseLike, position: ArrayLike, twist: Array | None = None
    ) -> Wrench:
        """The wrench on the probe in one pose and motion.

        Args:
            rotation: Probe to patient, a matrix (3, 3) or a SciPy `Rotation`.
            position: Origin of the probe frame, patient frame, shape (3,) [m].
            twist: Velocity of that origin and angular velocity, patient axes, shape
                (6,) [m/s, rad/s]; at rest when not given.

        Returns:
            Force [N] and torque about the shell's reference [N·m], patient axes.

        Raises:
            InputError: Not fitted yet, or an invalid pose or twist.
        """
        self._require_fit()
        R, at = pose_of(rotation, position)
        R = rotations(np.asarray(R))
        motion = np.zeros(6) if twist is None else np.asarray(twist, dtype=float)
        if motion.shape != (6,) or not np.isfinite(motion).all():
            raise InputError(
                f"a twist must be 6 finite numbers [m/s, rad/s], got {motion}"
            )
        if not np.isfinite(at).all():
            raise InputError(f"a position must be finite [m], got {at}")
        wrench, touching = self._wrench(R, np.asarray(at, dtype=float), motion)
        return Wrench(wrench[:3], wrench[3:], touching, in_grid=True)

    def wrenches(self, trajectory: Trajectory) -> Array:
        """Force, then torque, of every frame, as from `render`, shape (n, 6) [N, N·m].

        Raises:
            InputError: Not fitted yet.
        """
        self._require_fit()
        frames = zip(
            trajectory.rotation, trajectory.position, trajectory.twist(), strict=True
        )
        return np.array([self._wrench(*frame)[0] for frame in frames])

    def parameters(self) -> dict[str, float]:
        """Fitted parameters, by name with unit; empty for a field."""
        return {}

    def _require_contact(self, recording: Trajectory, force: Array) -> None:
        """Refuse recordings in which no shell point is ever below the surface."""
        local = self.shell.points
        for t in np.argsort(-np.linalg.norm(force, axis=1)):
            points = local @ recording.rotation[t].T + recording.position[t]
            if (self.surface.depth_of(points) > 0.0).any():
                return
        raise no_contact(self.name)

    def _require_fit(self) -> None:
        if self.needs_fit and not self.fitted:
            raise InputError(
                f"{self.name} is not fitted yet: call fit(trajectories) first"
            )

    @abstractmethod
    def _fit(self, recording: Trajectory, force: Array) -> None:
        """Fit to one recording, of several segments, and its forces (T, 3) [N]."""

    @abstractmethod
    def _wrench(self, R: Array, at: Array, twist: Array) -> tuple[Array, int]:
        """Force and torque of a valid pose, shape (6,), and points in contact."""


class OneStiffness(Comparator):
    """A comparator whose wrench is one stiffness times a function of the pose.

    Attributes:
        stiffness: Fitted by least squares to the measured forces.
        stiffness_unit: Its unit.
    """

    stiffness_unit: ClassVar[str] = "N/m³"
    stiffness: float = 1.0

    def parameters(self) -> dict[str, float]:
        """The stiffness."""
        return {f"stiffness [{self.stiffness_unit}]": self.stiffness}

    def _fit(self, recording: Trajectory, force: Array) -> None:
        frames = zip(recording.rotation, recording.position, strict=True)
        shape = np.array([self._unit_wrench(*frame)[0][:3] for frame in frames])
        self.stiffness = positive_scale(shape, force, self.name)

    def _wrench(self, R: Array, at: Array, twist: Array) -> tuple[Array, int]:
        unit, touching = self._unit_wrench(R, at)
        return self.stiffness * unit, touching

    @abstractmethod
    def _unit_wrench(self, R: Array, at: Array) -> tuple[Array, int]:
        """Wrench for a stiffness of 1, shape (6,), and points in contact."""


def positive_scale(shape: Array, force: Array, name: str) -> float:
    """The scale s that minimises ‖s shape − force‖².

    Args:
        shape: Predicted forces for a scale of 1, shape (T, 3).
        force: Measured, shape (T, 3) [N].
        name: Name of the comparator, for the message.

    Raises:
        InputError: Nothing is in contact, or the best scale is not positive.
    """
    square = float((shape**2).sum())
    if square == 0.0:
        raise no_contact(name)
    scale = float((shape * force).sum()) / square
    if scale <= 0.0:
        raise InputError(
            f"{name}: the measured forces pull the probe in: give the force ON the "
            "probe in patient axes"
        )
    return scale


def no_contact(name: str) -> InputError:
    """The error of a comparator whose probe touches in no frame."""
    return InputError(
        f"{name}: the probe touches the surface in no frame: check the recordings' "
        "frame and unit"
    )


def _checked_cloud(surface: Surface, cloud: Array | None) -> Array:
    if cloud is None:
        return surface.points().reshape(-1, 3)
    points = np.asarray(cloud, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 10:
        raise InputError(
            f"cloud must be at least 10 points (n, 3) [m], got shape {points.shape}"
        )
    if not np.isfinite(points).all():
        raise InputError("cloud holds NaN or infinite points: drop them")
    return points
