"""Standard deviation of a rendered force, looked up in a map over the skin."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.uncertainty_map import UncertaintyMap


@dataclass(frozen=True)
class ForceUncertainty:
    """What a renderer knows of its forces' uncertainty.

    Attributes:
        relative: Relative standard deviation over the skin; None if unknown.
    """

    relative: UncertaintyMap | None

    @classmethod
    def of(
        cls, given: UncertaintyMap | bool | None, field: PotentialField
    ) -> ForceUncertainty:
        """The map to use: the one given, or with True the field's own.

        Raises:
            InputError: The map is missing, or of another body.
        """
        if given is None or given is False:
            return cls(None)
        if isinstance(given, UncertaintyMap):
            surface = field.voxmap.surface
            if given.z[0] < surface.z[0] or given.z[-1] > surface.z[-1]:
                raise InputError(
                    f"the uncertainty map has heights from {given.z[0]:g} to "
                    f"{given.z[-1]:g} m, the field's body from {surface.z[0]:g} to "
                    f"{surface.z[-1]:g} m: give the map of this field"
                )
            return cls(given)
        if given is not True or field.uncertainty is None:
            raise InputError(
                "uncertainty=True needs a field with an uncertainty map: fit with "
                "ttus-opt fit --uncertainty, or give the map of "
                "fitting.uncertainty.skin_uncertainty.uncertainty_map"
            )
        return cls(field.uncertainty)

    def std(self, wrench: Array, position: Array) -> float:
        """Standard deviation of a frame's force, by the map under the probe [N].

        Args:
            wrench: Force, then torque, shape (6,) [N, N·m].
            position: The probe's origin, patient frame, shape (3,) [m].

        Returns:
            NaN if unknown; 0 without force.
        """
        if self.relative is None:
            return math.nan
        size = math.hypot(*wrench[:3].tolist())
        return self.relative.at(*position.tolist()) * size if size else 0.0
