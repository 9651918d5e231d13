"""The loop of the node, without ROS: the newest pose in, a wrench at each tick.

Between two poses the last one holds. Without a pose for `timeout` the wrench fades to
zero over as long again, so that a device does not push on by itself when its tracker
falls silent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import ttus_opt as tt
from ttus_opt.core.errors import InputError
from ttus_opt.probe.pose import pose_of, rotations


@dataclass(frozen=True)
class Settings:
    """What a node is started with.

    Attributes:
        field_file: Field file (.nc).
        probe: ``ellipsoid:a,b,c`` [m], or the path of a mesh.
        probe_unit: Unit of the mesh.
        frame_id: Name of the patient frame: poses in another one are refused.
        rate: Wrenches per second [Hz].
        timeout: Time without a pose after which the wrench begins to fade [s].
        force_limit: Larger forces are scaled down to it [N].
    """

    field_file: str
    probe: str
    probe_unit: str = "mm"
    frame_id: str = "patient"
    rate: float = 500.0
    timeout: float = 0.1
    force_limit: float = 15.0

    def __post_init__(self) -> None:
        """Refuse what would give no wrench or never end."""
        for name in ("field_file", "probe", "frame_id"):
            if not getattr(self, name):
                raise InputError(f"give the parameter {name}")
        for name in ("rate", "timeout"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise InputError(f"{name} must be positive, got {getattr(self, name)}")


class WrenchLoop:
    """Wrenches of a field for a stream of poses.

    `take` and `tick` are called by one thread; `swap` may be called by another.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._renderer = tt.Renderer(
            tt.PotentialField.load(settings.field_file),
            tt.PointShell.from_spec(settings.probe, unit=settings.probe_unit),
            blend=tt.BlendLaw(frame_seconds=1.0 / settings.rate),
            force_limit=settings.force_limit,
        )
        self._rotation, self._position = np.eye(3), np.zeros(3)
        self._stamp = -np.inf  # of the newest pose, by its sender's clock [s]
        self._came = -np.inf  # when it came, by the clock of `tick` [s]
        self._wrench = np.zeros(6)

    def take(
        self,
        frame_id: str,
        stamp: float,
        position: Sequence[float],
        quaternion: Sequence[float],
        now: float,
    ) -> None:
        """Keep a pose as the newest.

        Args:
            frame_id: Frame of the pose.
            stamp: Its time by the sender's clock [s].
            position: Origin of the probe frame [m].
            quaternion: Probe to patient, x, y, z, w.
            now: Time by a clock that never goes back [s].

        Raises:
            InputError: Another frame, a stamp that goes back, or no rigid pose.
        """
        if frame_id != self.settings.frame_id:
            raise InputError(
                f"a pose in {frame_id!r}: transform it to {self.settings.frame_id!r}, "
                "or name its frame by the parameter frame_id"
            )
        if not stamp >= self._stamp:
            raise InputError(
                f"a pose of {stamp:.6f} s after one of {self._stamp:.6f} s: if the "
                "sender's clock was set back, start the node anew"
            )
        rotation, at = pose_of(quaternion, position, "xyzw")
        if not np.isfinite(at).all():
            raise InputError(f"a position that is not finite: {at.tolist()}")
        self._rotation, self._position = rotations(rotation[None])[0], at
        self._stamp, self._came = stamp, now

    def tick(self, now: float) -> NDArray[np.float64] | None:
        """Force [N] and torque [N m] on the probe, patient axes, shape (6,).

        Args:
            now: As for `take` [s].

        Returns:
            The wrench, valid until the next tick; None before the first pose.
        """
        if self._stamp == -np.inf:
            return None
        self._renderer.render_into(
            self._rotation, self._position, self._wrench, time=self._stamp
        )
        age = (now - self._came) / self.settings.timeout
        self._wrench *= min(max(2.0 - age, 0.0), 1.0)
        return self._wrench

    def swap(self, field_file: str) -> None:
        """Blend in another field of the same grid, surface and sampling.

        Raises:
            TtusError: The file cannot be read, or holds another grid or surface; the
                present field goes on.
        """
        self._renderer.update(tt.PotentialField.load(field_file))
