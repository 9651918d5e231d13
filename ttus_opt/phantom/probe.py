"""A rigid ellipsoid: how far it reaches below the skin along given rays.

This is an analytic description of the probe, so that the simulation shares nothing with
the sampled point shell of the fit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError


@dataclass(frozen=True)
class EllipsoidProbe:
    """A rigid ellipsoid centred on the pose.

    Attributes:
        semi_axes: Semi-axes along the probe's x, y and z [m].
    """

    semi_axes: tuple[float, float, float]

    def __post_init__(self) -> None:
        """Check that the semi-axes are three positive finite lengths."""
        good = all(math.isfinite(a) and a > 0.0 for a in self.semi_axes)
        if len(self.semi_axes) != 3 or not good:
            raise InputError(
                f"semi_axes must be 3 positive lengths [m], got {self.semi_axes}"
            )

    def reach(
        self, points: Array, directions: Array, rotation: Array, position: Array
    ) -> tuple[Array, Array]:
        """Find where rays leave the probe.

        Args:
            points: Starts of the rays, patient frame, shape (n, 3) [m].
            directions: Unit directions, shape (n, 3) [–].
            rotation: Probe to patient, shape (3, 3) [–].
            position: Probe's centre, shape (3,) [m].

        Returns:
            Length along the ray to the probe's far side, negative for a gap and -inf if
            the ray misses the probe, (n,) [m]; the probe's outward unit normals there,
            NaN if the ray misses it, (n, 3) [–].
        """
        semi = np.asarray(self.semi_axes)
        start = (points - position) @ rotation / semi
        step = directions @ rotation / semi
        a = np.einsum("ij,ij->i", step, step)
        b = np.einsum("ij,ij->i", start, step)
        c = np.einsum("ij,ij->i", start, start) - 1.0
        square = b * b - a * c
        hit = square > 0.0
        depth = np.full(len(points), -np.inf)
        depth[hit] = (np.sqrt(square[hit]) - b[hit]) / a[hit]
        normals = np.full((len(points), 3), np.nan)
        leave = (start[hit] + depth[hit, None] * step[hit]) / semi @ rotation.T
        normals[hit] = leave / np.linalg.norm(leave, axis=1, keepdims=True)
        return depth, normals

    def support(self, rotation: Array, direction: Array) -> float:
        """Distance from the centre to the tangent plane normal to a direction [m].

        Args:
            rotation: Probe to patient, shape (3, 3) [–].
            direction: Unit direction, patient frame, shape (3,) [–].
        """
        return float(
            np.linalg.norm(np.asarray(self.semi_axes) * (direction @ rotation))
        )
