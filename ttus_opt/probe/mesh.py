"""Triangle meshes: read from a file in metres, welded, without degenerate faces.

Only what the point shell needs. trimesh parses the files; everything else is done here,
so that no mesh is repaired silently.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core import io
from ttus_opt.core.arguments import expect_one_of
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import FileError, GeometryError, InputError

#: Metres per file unit.
METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 25.4e-3}

SUFFIXES = (".stl", ".ply", ".obj")

#: No coordinate is as large: squares of areas would overflow [m]
FARTHEST = 1e75


@dataclass(frozen=True)
class TriangleMesh:
    """Triangles on shared vertices, every one with an area.

    Attributes:
        vertices: Shape (n, 3) [m].
        faces: Vertex indices; the winding may be anything, shape (k, 3) [–].
    """

    vertices: Array
    faces: IntArray

    def __post_init__(self) -> None:
        """Validate the mesh.

        Raises:
            InputError: Wrong shapes, indices out of range, or coordinates that are
                not finite.
            GeometryError: No faces, or no area.
        """
        if self.vertices.ndim != 2 or self.vertices.shape[1] != 3:
            raise InputError(
                f"vertices must be (n, 3) [m], got {self.vertices.shape}: transposed?"
            )
        if self.faces.ndim != 2 or self.faces.shape[1] != 3:
            raise InputError(f"faces must be (k, 3) indices, got {self.faces.shape}")
        if len(self.faces) == 0:
            raise GeometryError("the mesh has no faces: export the probe as triangles")
        if self.faces.min() < 0 or self.faces.max() >= len(self.vertices):
            raise InputError(
                f"faces index vertices {self.faces.min()} to {self.faces.max()}, but "
                f"there are {len(self.vertices)}: a damaged mesh?"
            )
        bad = np.asarray(~(np.abs(self.vertices) < FARTHEST).all(axis=1))
        if bad.any():
            raise InputError(
                f"{int(bad.sum())} of {len(bad)} mesh vertices are not finite, or "
                f"huge, the first is number {int(bad.argmax())}: export the mesh again"
            )
        if not self.area > 1e-12 * max(self.extent, 1e-300) ** 2:
            raise GeometryError(
                f"the probe has zero area ({len(self.faces)} faces, all degenerate): "
                "export the mesh again"
            )

    @cached_property
    def corners(self) -> Array:
        """Corner points of every face, shape (k, 3 corners, 3) [m]."""
        return self.vertices[self.faces]

    @cached_property
    def vector_areas(self) -> Array:
        """Area times unit normal by the faces' own winding, shape (k, 3) [m²]."""
        c = self.corners
        return np.asarray(0.5 * np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]))

    @cached_property
    def areas(self) -> Array:
        """Area of every face, shape (k,) [m²]."""
        return np.asarray(np.linalg.norm(self.vector_areas, axis=1))

    @property
    def area(self) -> float:
        """Area of all faces together [m²]."""
        return float(self.areas.sum())

    @property
    def extent(self) -> float:
        """Longest edge of the bounding box of all vertices [m]."""
        return float(np.ptp(self.vertices, axis=0).max())

    def cleaned(self) -> TriangleMesh:
        """The same surface welded, without degenerate faces and unused vertices.

        Of faces with the same corners the first is kept.

        Raises:
            GeometryError: No face is left.
        """
        import trimesh

        mesh = trimesh.Trimesh(self.vertices, self.faces, process=False)
        size = max(float(np.abs(self.vertices).max()), 1e-300)
        mesh.merge_vertices(digits_vertex=15 - math.ceil(math.log10(size)))
        mesh.update_faces(mesh.unique_faces())
        mesh.update_faces(mesh.area_faces > 1e-14 * self.extent**2)
        mesh.remove_unreferenced_vertices()
        return TriangleMesh(np.array(mesh.vertices), np.array(mesh.faces, np.int64))

    def subset(self, keep: NDArray[np.bool_]) -> TriangleMesh:
        """The mesh of the faces where ``keep`` (k,) is true, in the same order."""
        return TriangleMesh(self.vertices, self.faces[keep])

    def flipped(self, flip: NDArray[np.bool_]) -> TriangleMesh:
        """The mesh with the winding turned where ``flip`` (k,) is true."""
        return TriangleMesh(
            self.vertices, np.where(flip[:, None], self.faces[:, ::-1], self.faces)
        )

    def convex_hull(self) -> TriangleMesh:
        """The convex hull of all vertices, wound outwards.

        Raises:
            GeometryError: The vertices lie in a plane.
        """
        from scipy.spatial import ConvexHull, QhullError

        try:
            hull = ConvexHull(self.vertices)
        except QhullError as error:
            raise GeometryError(
                "the mesh is flat and has no convex hull: use surface='all'"
            ) from error
        mesh = TriangleMesh(self.vertices, hull.simplices.astype(np.int64))
        outward = hull.equations[:, :3]
        return mesh.flipped((mesh.vector_areas * outward).sum(axis=1) < 0)


def require_plausible_extent(
    extent: float, given: str, *, in_a_unit: bool = True
) -> None:
    """Refuse a probe that is larger than 1 m or smaller than 1 mm.

    Args:
        extent: Longest edge of its bounding box [m].
        given: Source of the size, for the message ("probe.stl in unit 'm'").
        in_a_unit: Whether its unit is an option; primitives are in metres.

    Raises:
        GeometryError: The size is not that of a probe.
    """
    if not 1e-3 <= extent <= 1.0:
        remedy = "are these metres already? pass unit='m'"
        if extent > 1.0:
            remedy = "are these millimetres? pass unit='mm'"
        if not in_a_unit:
            remedy = "give its measures in metres"
        raise GeometryError(
            f"{given} is {extent:.4g} m long, expected a probe of 1 mm to 1 m: {remedy}"
        )


def read_mesh(path: str | os.PathLike[str], *, unit: str = "mm") -> TriangleMesh:
    """Read a probe mesh.

    Args:
        path: STL (binary or text), PLY or OBJ.
        unit: Unit of length of the file, one of m, cm, mm, in; meshes carry none.

    Returns:
        The mesh in metres, in the file's own frame, cleaned.

    Raises:
        FileError: Missing, empty, not readable, or of another format.
        InputError: An unknown unit, or coordinates that are not finite.
        GeometryError: No faces, no area, or not the size of a probe.
    """
    expect_one_of(unit, METRES, "unit")
    file = io.existing_file(path, "probe mesh")
    if file.suffix.lower() not in SUFFIXES:
        raise FileError(
            f"probe mesh {file} is not one of {', '.join(SUFFIXES)}: export it as STL"
        )
    import trimesh

    try:
        loaded = trimesh.load_mesh(file, process=False)
        vertices = np.asarray(loaded.vertices, dtype=float)
        faces = np.asarray(loaded.faces, dtype=np.int64)
        if file.suffix.lower() == ".stl" and not len(faces):
            # a binary file that is cut off is read as text, which may hold no facet
            raise ValueError("no faces")
    except Exception as error:  # parsers raise whatever the damage leads to
        raise FileError(
            f"probe mesh {file} cannot be read ({type(error).__name__}): truncated, or "
            f"not a triangle mesh in {file.suffix[1:].upper()} format?"
        ) from error
    try:
        mesh = TriangleMesh(vertices * METRES[unit], faces.reshape(-1, 3)).cleaned()
    except InputError as error:  # or the GeometryError that it may be
        raise type(error)(f"{file}: {error}") from error
    require_plausible_extent(mesh.extent, f"{file} in unit '{unit}'")
    return mesh
