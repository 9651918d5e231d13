"""Relative uncertainty of the force of a press, as a map over the surface.

For places θ and z, the map holds the standard deviation of a press's force over that
force. A frame's standard deviation is the map's value under the probe, bilinear between
places, times the frame's force. This assumes that uncertainty is proportional to force
and independent of orientation; `ttus_opt.fitting.uncertainty.field_uncertainty` assumes
neither.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError

#: Variable of a field file, and its dimensions
VARIABLE, DIMS = "uncertainty", ("uncertainty_theta", "uncertainty_z")

#: Tolerance of equal steps [rad, m]
STEP = 1e-6


@dataclass(frozen=True)
class UncertaintyMap:
    """Relative standard deviation of a press over the skin.

    Attributes:
        theta: Angles of the places, from 0 in equal steps around, shape (n,) [rad].
        z: Their heights in equal steps, shape (m,) [m].
        relative: Standard deviation of the force over the force, shape (n, m) [–].
    """

    theta: Array = field(repr=False)
    z: Array = field(repr=False)
    relative: Array = field(repr=False)

    def __post_init__(self) -> None:
        """Validate shapes, equal steps, and values that are finite, none negative."""
        shape = len(self.theta), len(self.z)
        if self.relative.shape != shape or len(self.z) < 2 or not len(self.theta):
            raise InputError(
                f"an uncertainty map needs relative of shape {shape} and two heights "
                f"or more, got {self.relative.shape}"
            )
        if not (np.isfinite(self.relative).all() and (self.relative >= 0.0).all()):
            raise InputError(
                "an uncertainty map needs standard deviations that are not negative"
            )
        if not (_in_steps(self.theta) and abs(self.theta[0]) < STEP and self._closed()):
            raise InputError(
                "an uncertainty map needs angles from 0 in equal steps around"
            )
        if not _in_steps(self.z):
            raise InputError(
                "an uncertainty map needs heights that increase in equal steps"
            )

    def _closed(self) -> bool:
        around = 2.0 * math.pi / len(self.theta)
        return bool(abs(self.theta[-1] + around - 2.0 * math.pi) < STEP)

    @cached_property
    def _rows(self) -> list[list[float]]:
        """The values as plain numbers: faster than NumPy for a single place."""
        return [[float(v) for v in row] for row in self.relative]

    @cached_property
    def _steps(self) -> tuple[float, float, float]:
        """Places per rad, the first height, places per m."""
        z = self.z
        return (
            len(self.theta) / (2.0 * math.pi),
            float(z[0]),
            (len(z) - 1) / float(z[-1] - z[0]),
        )

    def at(self, x: float, y: float, z: float) -> float:
        """The value at the place under a point, patient frame [m]."""
        rows, (around, lowest, along) = self._rows, self._steps
        a = (math.atan2(y, x) * around) % len(rows)
        b = min(max((z - lowest) * along, 0.0), len(rows[0]) - 1.0)
        i, k = int(a) % len(rows), min(int(b), len(rows[0]) - 2)
        s, t = a - int(a), b - k
        one, other = rows[i], rows[(i + 1) % len(rows)]
        low = one[k] + s * (other[k] - one[k])
        return low + t * (one[k + 1] + s * (other[k + 1] - one[k + 1]) - low)

    def variables(self) -> dict[str, Any]:
        """Variables and coordinates with units, for a field file."""
        note = "standard deviation of a press's force over that force"
        return {
            VARIABLE: (DIMS, self.relative, {"units": "1", "long_name": note}),
            DIMS[0]: (DIMS[:1], self.theta, {"units": "rad"}),
            DIMS[1]: (DIMS[1:], self.z, {"units": "m"}),
        }

    @classmethod
    def of_file(cls, data: io.Content) -> UncertaintyMap | None:
        """The map in a field file; None without one.

        Raises:
            InputError: Other dimensions or units, or an invalid map.
        """
        if VARIABLE not in data.variables:
            return None
        return cls(
            io.array_of(data, DIMS[0], DIMS[:1], "rad"),
            io.array_of(data, DIMS[1], DIMS[1:], "m"),
            io.array_of(data, VARIABLE, DIMS, "1"),
        )


def _in_steps(values: Array) -> bool:
    """Whether values increase in equal steps; false with NaN."""
    steps = np.diff(values)
    equal = np.abs(steps - steps.mean()) < STEP if len(steps) else np.isfinite(values)
    return bool(equal.all() and (steps > 0.0).all())
