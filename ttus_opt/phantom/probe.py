"""A rigid ellipsoid: how far it reaches below the skin along given rays.

The contact's own description of a probe, analytic, so that the physics shares
nothing with the sampled point shell that is fitted to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.errors import InputError


@dataclass(frozen=True)
class ProbeReach:
    """Where rays leave the probe.

    Attributes:
        depth: Length along the ray to the probe's far side, -inf where the ray
            misses, shape (n,) [m].
        normals: Outward unit normals of the probe there, NaN where it misses,
            shape (n, 3) [–].
    """

    depth: Array
    normals: Array


@dataclass(frozen=True)
class EllipsoidProbe:
    """A rigid ellipsoid centred on the pose.

    Attributes:
        semi_axes: Along the probe's own x, y, z [m].
    """

    semi_axes: tuple[float, float, float]

    def __post_init__(self) -> None:
        """Refuse semi-axes other than three positive finite lengths."""
        good = all(math.isfinite(a) and a > 0.0 for a in self.semi_axes)
        if len(self.semi_axes) != 3 or not good:
            raise InputError(
                f"semi_axes must be 3 positive lengths [m], got {self.semi_axes}"
            )

    def reach(
        self, points: Array, directions: Array, rotation: Array, position: Array
    ) -> ProbeReach:
        """Follow rays to where they leave the probe.

        Args:
            points: Where the rays start, patient frame, shape (n, 3) [m].
            directions: Unit directions, shape (n, 3) [–].
            rotation: Probe to patient, shape (3, 3) [–].
            position: Probe's centre, shape (3,) [m].

        Returns:
            Depth and normal for every ray; a negative depth is a gap.
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
        return ProbeReach(depth, normals)

    def support(self, rotation: Array, direction: Array) -> float:
        """How far the probe extends from its centre along a direction.

        Args:
            rotation: Probe to patient, shape (3, 3) [–].
            direction: Unit direction, patient frame, shape (3,) [–].

        Returns:
            The distance of the touching plane from the centre [m].
        """
        return float(
            np.linalg.norm(np.asarray(self.semi_axes) * (direction @ rotation))
        )
