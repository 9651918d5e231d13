"""How a force sensor is mounted: three independent statements.

*Axes*: the rotation from sensor to probe. *Reference point*: the point about which it
measures torques. *Sign*: whether it measures the force on the probe or the force that
the probe exerts. The wrench columns of a recording hold raw readings, in sensor axes
and about the reference point.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Literal, get_args

import numpy as np

from ttus_opt.core.arguments import expect_one_of
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError, located
from ttus_opt.probe.pose import rotations
from ttus_opt.probe.trajectory import Trajectory

Sign = Literal["on-probe", "by-probe"]

#: Larger readings are counts or in another unit [N, N·m]
LARGEST_READING = 1e4

#: Reference points farther away are in another unit [m]
FARTHEST = 2.0


@dataclass(frozen=True)
class ForceSensor:
    """A six-axis force sensor between the hand and the probe.

    Attributes:
        axes: Sensor to probe, shape (3, 3) [–].
        point: Reference point of torques, probe frame, shape (3,) [m].
        sign: ``on-probe``: a push on the probe along the sensor's x reads positive.
            ``by-probe``: it reads negative.
    """

    axes: Array = field(default_factory=lambda: np.eye(3))
    point: Array = field(default_factory=lambda: np.zeros(3))
    sign: Sign = "on-probe"

    def __post_init__(self) -> None:
        """Validate the statements.

        Raises:
            InputError: Axes that are not a rotation, an invalid point or sign.
        """
        axes, point = np.asarray(self.axes, float), np.asarray(self.point, float)
        if axes.shape != (3, 3):
            raise InputError(f"axes must be a rotation (3, 3), got {axes.shape}")
        with located("axes of the sensor"):
            object.__setattr__(self, "axes", rotations(axes))
        if point.shape != (3,) or not np.abs(point).max() < FARTHEST:
            raise InputError(
                f"point must be x,y,z within {FARTHEST:g} m of the probe's origin, got "
                f"{point.tolist()}: is it in millimetres?"
            )
        object.__setattr__(self, "point", point)
        expect_one_of(self.sign, get_args(Sign), "sign")

    def readings(self, raw: Trajectory, what: str) -> tuple[Array, Array]:
        """Raw force (T, 3) [N] and torque (T, 3) [N·m] on the probe, sensor axes.

        Args:
            raw: The recording.
            what: What it is, for the message.

        Raises:
            InputError: No force or torque, or one in another unit.
        """
        if raw.force is None or raw.torque is None:
            raise InputError(
                f"the {what} needs forces and torques: columns fx,fy,fz,tx,ty,tz"
            )
        most = max(float(np.abs(raw.force).max()), float(np.abs(raw.torque).max()))
        if not most < LARGEST_READING:
            raise InputError(
                f"the {what} reads up to {most:.3g}, at most {LARGEST_READING:g} N or "
                "N m is plausible: are these counts? Convert them"
            )
        return self.factor * raw.force, self.factor * raw.torque

    @property
    def factor(self) -> float:
        """Factor from readings to forces on the probe: 1 or −1."""
        return 1.0 if self.sign == "on-probe" else -1.0

    def statements(self) -> dict[str, Any]:
        """The three statements, as a model's file stores them."""
        return {
            name: np.asarray(value).tolist() for name, value in asdict(self).items()
        }
