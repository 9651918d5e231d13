"""The patient's skin as a mesh of nodes, cut open, and met by a ray."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ttus_opt.contact.standing import skin_points
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.probe.cylindrical import TURN
from ttus_opt.scan.surface import Surface

#: Distance between nodes: the skin's shape to a fraction of a millimetre [m]
SPACING = 0.01

#: Steps along a ray, and bisections of the one in which it enters [–]
RAY_STEPS, BISECTIONS = 400, 20


@dataclass(frozen=True)
class SkinMesh:
    """Nodes of the skin and the triangles between them.

    Attributes:
        theta: Angle of every node, shape (n,) [rad].
        z: Height of every node, shape (n,) [m].
        vertices: The nodes, patient frame, shape (n, 3) [m].
        faces: Their indices, outward by the right-hand rule, shape (k, 3) [–].
    """

    theta: Array = field(repr=False)
    z: Array = field(repr=False)
    vertices: Array = field(repr=False)
    faces: IntArray = field(repr=False)

    @classmethod
    def of(cls, surface: Surface, spacing: float = SPACING) -> SkinMesh:
        """Nodes about ``spacing`` [m] apart, from the first slice to the last."""
        around = max(round(TURN * float(surface.radius.mean()) / spacing), 24)
        low, high = float(surface.z[0]), float(surface.z[-1])
        along = max(round((high - low) / spacing) + 1, 8)
        angle, height = np.meshgrid(
            np.arange(around) * TURN / around,
            np.linspace(low, high, along),
            indexing="ij",
        )
        index = np.arange(around * along).reshape(around, along)
        a, b = index[:, :-1], np.roll(index, -1, axis=0)[:, :-1]
        c, d = np.roll(index, -1, axis=0)[:, 1:], index[:, 1:]
        one, other = np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)
        faces = np.concatenate([one.reshape(-1, 3), other.reshape(-1, 3)])
        theta, z = angle.ravel(), height.ravel()
        return cls(theta, z, skin_points(surface, theta, z), faces)

    def cut(self, normal: Array, offset: float) -> IntArray:
        """Faces that lie behind a plane, n · x ≤ offset, shape (k, 3)."""
        behind: NDArray[np.bool_] = self.vertices @ normal <= offset
        return np.asarray(self.faces[behind[self.faces].any(axis=1)])


def place_on_ray(surface: Surface, origin: Array, ray: Array) -> tuple[float, float]:
    """Where a ray first meets the skin, or the place that it passes closest.

    Args:
        surface: The skin.
        origin: A point of the ray outside the body, patient frame, shape (3,) [m].
        ray: Its direction, shape (3,).

    Returns:
        Angle [rad] and height [m], between the first slice and the last.
    """
    ray = ray / np.linalg.norm(ray)
    low, high = float(surface.z[0]), float(surface.z[-1])
    size = float(surface.radius.max()) + 0.5 * (high - low)
    middle = np.array([0.0, 0.0, 0.5 * (low + high)])
    way = float((middle - origin) @ ray)
    along = np.linspace(max(way - size, 0.0), max(way, 0.0) + size, RAY_STEPS)

    def above(t: Array) -> Array:
        """Height above the skin; the body ends at its first and last slice."""
        x, y, z = (origin + t[:, None] * ray).T
        radial = np.hypot(x, y) - surface.radius_at(np.arctan2(y, x), z)
        return np.asarray(np.maximum(radial, np.maximum(low - z, z - high)))

    heights = above(along)
    inside = np.flatnonzero(heights <= 0.0)
    if len(inside) and inside[0] > 0:
        out, within = along[inside[0] - 1], along[inside[0]]
        for _ in range(BISECTIONS):
            half = 0.5 * (out + within)
            out, within = (half, within) if above(half[None])[0] > 0 else (out, half)
        t = out
    else:
        t = along[int(heights.argmin())]
    x, y, z = origin + t * ray
    return float(np.arctan2(y, x)), float(np.clip(z, low, high))
