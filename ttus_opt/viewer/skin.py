"""The patient's skin as a mesh of nodes, cut open, as a file, and met by a ray."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import bisect

from ttus_opt.contact.standing import skin_frames, skin_points
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.probe.cylindrical import TURN
from ttus_opt.scan.surface import Surface

#: Distance between nodes: the skin's shape to a fraction of a millimetre [m]
SPACING = 0.01

#: A material whose colours are drawn as they are, seen from both sides
MATERIAL = {
    "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
    "extensions": {"KHR_materials_unlit": {}},
    "doubleSided": True,
}

#: What is drawn: faces, then vertices and their colours
DRAWN = {"indices": 0, "attributes": {"POSITION": 1, "COLOR_0": 2}, "material": 0}

#: glTF's numbers of the types of numbers
TYPES = {"uint32": 5125, "float32": 5126, "uint16": 5123}

#: What a colour of 1 is stored as
MOST = 2**16 - 1

#: What two computations of a place may differ by [m]
ROUNDED = 1e-9

#: How far a ray may pass the skin and still point at it [m]
NEAR = 0.003

#: Steps along a ray [–], and how exactly the place in the one is found in which it
#: enters [m]
RAY_STEPS, EXACT = 400, 1e-6


@dataclass(frozen=True)
class SkinMesh:
    """Nodes of the skin and the triangles between them.

    Attributes:
        theta: Angle of every node, shape (n,) [rad].
        z: Height of every node, shape (n,) [m].
        vertices: The nodes, patient frame, shape (n, 3) [m].
        faces: Their indices, outward by the right-hand rule, shape (k, 3) [–].
        normals: Outward at every node, unit vectors, shape (n, 3) [–].
    """

    theta: Array = field(repr=False)
    z: Array = field(repr=False)
    vertices: Array = field(repr=False)
    faces: IntArray = field(repr=False)
    normals: Array = field(repr=False)

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
        normals = skin_frames(surface, theta, z)[:, :, 0]
        return cls(theta, z, skin_points(surface, theta, z), faces, normals)

    def cut(self, normal: Array, offset: float) -> IntArray:
        """Faces that lie behind a plane, n · x ≤ offset, shape (k, 3)."""
        # a slider's place in mm may fall short of the skin's end by a rounding error
        behind: NDArray[np.bool_] = self.vertices @ normal <= offset + ROUNDED
        return np.asarray(self.faces[behind[self.faces].any(axis=1)])

    def glb(self, light: Array, faces: IntArray) -> bytes:
        """The skin as a binary glTF 2.0 file.

        Args:
            light: That the nodes send, linear, 0 to 1, shape (n, 3).
            faces: Those to draw, shape (k, 3) [–].
        """
        rgba = np.full((len(light), 4), MOST, dtype=np.uint16)
        rgba[:, :3] = np.rint(MOST * np.minimum(light, 1.0))
        arrays = {
            "SCALAR": faces.reshape(-1, 1).astype("<u4"),
            "VEC3": self.vertices.astype("<f4"),
            "VEC4": rgba,
        }
        parts = [values.tobytes() for values in arrays.values()]
        ends = np.cumsum([0, *map(len, parts)]).tolist()
        tree = {
            "asset": {"version": "2.0"},
            "extensionsUsed": ["KHR_materials_unlit"],
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [DRAWN]}],
            "materials": [MATERIAL],
            "accessors": [
                {
                    "bufferView": k,
                    "componentType": TYPES[values.dtype.name],
                    "normalized": values.dtype == np.uint16,
                    "type": kind,
                    "count": len(values),
                    "min": values.min(axis=0).tolist(),
                    "max": values.max(axis=0).tolist(),
                }
                for k, (kind, values) in enumerate(arrays.items())
            ],
            "bufferViews": [
                {"buffer": 0, "byteOffset": at, "byteLength": len(part)}
                for at, part in zip(ends, parts, strict=False)
            ],
            "buffers": [{"byteLength": ends[-1]}],
        }
        text = json.dumps(tree).encode()
        text += b" " * (-len(text) % 4)
        head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + ends[-1])
        chunks = struct.pack("<I4s", len(text), b"JSON"), text
        binary = struct.pack("<I4s", ends[-1], b"BIN\0"), *parts
        return b"".join((head, *chunks, *binary))


def place_on_ray(
    surface: Surface, origin: Array, ray: Array
) -> tuple[tuple[float, float], bool]:
    """Where a ray first meets the skin, or the place that it passes closest.

    Args:
        surface: The skin.
        origin: A point of the ray outside the body, patient frame, shape (3,) [m].
        ray: Its direction, shape (3,).

    Returns:
        Angle [rad] and height [m], between the first slice and the last; and whether
        the ray meets the skin, or passes it by less than `NEAR`.
    """
    ray = ray / np.linalg.norm(ray)
    low, high = float(surface.z[0]), float(surface.z[-1])
    size = float(surface.radius.max()) + 0.5 * (high - low)
    middle = np.array([0.0, 0.0, 0.5 * (low + high)])
    way = float((middle - origin) @ ray)
    along = np.linspace(max(way - size, 0.0), max(way, 0.0) + size, RAY_STEPS)

    def above(t: ArrayLike) -> Array:
        """Height above the skin; the body ends at its first and last slice."""
        points = origin + np.multiply.outer(t, ray)
        beyond = np.maximum(low - points[..., 2], points[..., 2] - high)
        return np.asarray(np.maximum(-surface.depth_of(points), beyond))

    heights = above(along)
    inside = np.flatnonzero(heights <= 0.0)
    if len(inside) and inside[0] > 0:
        enters = along[inside[0] - 1], along[inside[0]]
        t = bisect(lambda t: float(above(t)), *enters, xtol=EXACT)
    else:
        t = along[int(heights.argmin())]
    x, y, z = met = origin + t * ray
    place = float(np.arctan2(y, x)), float(np.clip(z, low, high))
    off = skin_points(surface, *np.array(place)) - met
    return place, bool(np.linalg.norm(off - (off @ ray) * ray) < NEAR)
