"""Noise models of depth cameras, by name.

Structured light (Nguyen, Izadi, Lovell, Modeling Kinect sensor noise for improved 3D
reconstruction and tracking, 3DIMPVT 2012), z in metres, θ the angle between the ray and
the surface's normal:

    σ_z = 0.0012 + 0.0019 (z − 0.4)² + 0.0001/√z · θ²/(π/2 − θ)²

Stereo, with focal length f [pixel], baseline b [m] and the disparity's deviation σ_d
[pixel]: z = f b / d, so σ_z = σ_d z²/(f b). Time of flight: one deviation along the
ray, as the manufacturer states it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError

#: Nearest depth [m] and largest angle [rad] of the published measurements; the model is
#: held constant beyond them
NEAREST, STEEPEST = 0.4, np.deg2rad(80.0)

#: Usual standard deviation of disparities in active stereo [pixel]
DISPARITY_STD = 0.1

#: Deviations and baselines beyond this are in another unit [m]
LARGEST = 1.0


@dataclass(frozen=True)
class Pixels:
    """Input of a noise model; arrays of one shape.

    Attributes:
        z: Along the optical axis [m].
        distance: Along the ray [m].
        incidence: Angle between the ray and the surface's normal [rad].
        focal: Focal length, one number [pixel].
    """

    z: Array
    distance: Array
    incidence: Array
    focal: float


@dataclass(frozen=True)
class StructuredLight:
    """Projected pattern (first Kinect, PrimeSense, Structure, Orbbec Astra)."""

    def along_ray(self, pixels: Pixels) -> Array:
        """Nguyen, Izadi, Lovell (2012), converted from σ_z to the ray [m]."""
        z = np.maximum(pixels.z, NEAREST)
        angle = np.minimum(pixels.incidence, STEEPEST)
        steep = 0.0001 / np.sqrt(z) * (angle / (np.pi / 2 - angle)) ** 2
        axial = 0.0012 + 0.0019 * (z - NEAREST) ** 2 + steep
        return np.asarray(axial * pixels.distance / pixels.z)


@dataclass(frozen=True)
class Stereo:
    """Two cameras, with or without a projector (RealSense D400, ZED).

    Attributes:
        baseline: Distance between the cameras [m].
        disparity_std: Standard deviation of a matched disparity [pixel].
    """

    baseline: float
    disparity_std: float = DISPARITY_STD

    def __post_init__(self) -> None:
        """Validate the numbers.

        Raises:
            InputError: One is not positive, or a baseline in millimetres.
        """
        if not 0.0 < self.baseline < LARGEST:
            raise InputError(
                f"a stereo baseline must be between 0 and {LARGEST:g} m, got "
                f"{self.baseline:g}: millimetres? divide by 1000"
            )
        if not 0.0 < self.disparity_std < 100.0:
            raise InputError(
                "a disparity's standard deviation must be above 0 pixels, got "
                f"{self.disparity_std:g}: {DISPARITY_STD:g} is usual"
            )

    def along_ray(self, pixels: Pixels) -> Array:
        """σ_d z² / (f b), converted from σ_z to the ray [m]."""
        axial = self.disparity_std * pixels.z**2 / (pixels.focal * self.baseline)
        return np.asarray(axial * pixels.distance / pixels.z)


@dataclass(frozen=True)
class TimeOfFlight:
    """Modulated light (HoloLens, Azure Kinect).

    Attributes:
        std: The manufacturer's standard deviation of a distance [m].
    """

    std: float

    def __post_init__(self) -> None:
        """Validate the number.

        Raises:
            InputError: It is not positive, or in millimetres.
        """
        if not 0.0 < self.std < LARGEST:
            raise InputError(
                f"a standard deviation of distances must be between 0 and {LARGEST:g} "
                f"m, got {self.std:g}: millimetres? divide by 1000"
            )

    def along_ray(self, pixels: Pixels) -> Array:
        """The same deviation everywhere [m]."""
        return np.full_like(pixels.distance, self.std)


#: Standard deviation of the distance along the ray, by ``along_ray`` [m]
NoiseModel = StructuredLight | Stereo | TimeOfFlight

NAMES = (
    "structured-light",
    "stereo:BASELINE[,DISPARITY_STD]",
    "time-of-flight:STD",
)


def noise_model(text: str) -> NoiseModel:
    """The noise model of a description.

    Args:
        text: ``structured-light``, ``stereo:0.05`` (baseline [m], and after a comma the
            disparity's deviation [pixel]) or ``time-of-flight:0.004`` (deviation [m]).

    Raises:
        InputError: An unknown model, or invalid numbers.

    >>> noise_model("stereo:0.05")
    Stereo(baseline=0.05, disparity_std=0.1)
    """
    name, _, rest = text.strip().lower().partition(":")
    try:
        values = [float(word) for word in rest.split(",")] if rest else []
    except ValueError:
        values = [np.nan]
    match name, len(values):
        case "structured-light", 0:
            return StructuredLight()
        case "stereo", 1 | 2:
            return Stereo(*values)
        case "time-of-flight", 1:
            return TimeOfFlight(*values)
    raise InputError(f"noise must be one of {', '.join(NAMES)}, got {text!r}")
