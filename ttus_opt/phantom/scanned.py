"""A torso with the tissue of `Torso` below a scanned surface."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter1d

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import GeometryError, InputError
from ttus_opt.phantom.torso import Torso
from ttus_opt.probe.cylindrical import TURN
from ttus_opt.scan.surface import Surface

#: Angles repeated beyond both ends of the turn, so that the spline is periodic
OVERLAP = 24


@dataclass(frozen=True)
class ScannedTorso(Torso):
    """A `Torso` whose skin is a scanned surface; z runs from 0 to ``length``.

    ``half_axes`` are those of the scan; ``exponent`` and ``swell`` are not used.

    Attributes:
        scanned: The surface; its lowest slice is the torso's z = 0.
        harmonics: Number of harmonics of the radius around the body to keep [–].
        smoothing: Standard deviation of the Gaussian that smooths along z [m].
    """

    scanned: Surface | None = field(default=None, repr=False)
    harmonics: int = 16
    smoothing: float = 0.006

    @classmethod
    def of(cls, surface: Surface, tissue: Torso) -> ScannedTorso:
        """Put the ribs, lump and moduli of another torso below a scanned surface.

        Raises:
            GeometryError: The surface is shorter than that torso.
        """
        length = float(surface.z[-1] - surface.z[0])
        if length < tissue.length:
            raise GeometryError(
                f"the scan is {length:.3f} m long, the torso {tissue.length:.3f} m: "
                "give a shorter torso or a longer scan"
            )
        quarter = len(surface.theta) // 4
        x = float(surface.radius[[0, 2 * quarter]].mean())
        y = float(surface.radius[[quarter, 3 * quarter]].mean())
        given = {f.name: getattr(tissue, f.name) for f in fields(Torso)}
        return cls(**{**given, "half_axes": (x, y), "scanned": surface})

    def radius(self, theta: Array, z: Array) -> Array:
        """Radius of the skin [m] at angles [rad] and heights [m], broadcast."""
        theta, z = np.broadcast_arrays(np.asarray(theta, float), np.asarray(z, float))
        return np.asarray(self._spline.ev(theta % TURN, z))

    @cached_property
    def _spline(self) -> RectBivariateSpline:
        """Twice differentiable interpolation of the smoothed radius."""
        if self.scanned is None:
            raise InputError("no surface was given: make it by ScannedTorso.of")
        theta, z = self.scanned.theta, self.scanned.z - self.scanned.z[0]
        waves = np.fft.rfft(self.scanned.radius, axis=0)
        waves[self.harmonics + 1 :] = 0.0
        radius = np.fft.irfft(waves, len(theta), axis=0)
        radius = gaussian_filter1d(
            radius, self.smoothing / (z[1] - z[0]), axis=1, mode="nearest"
        )
        around = [theta[-OVERLAP:] - TURN, theta, theta[:OVERLAP] + TURN]
        turned = [radius[-OVERLAP:], radius, radius[:OVERLAP]]
        return RectBivariateSpline(np.concatenate(around), z, np.concatenate(turned))
