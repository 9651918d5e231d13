"""The point shell: the probe's surface as evenly spread points with inward normals.

In the contact rows (eqs. 6, 7) every point pushes the probe along its normal, so
normals point INTO the probe, and each point carries its share of the area. Points are
in the probe's frame.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arguments import (
    expect_one_of,
    expect_shape,
    expect_whole,
    hold_numbers,
)
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import GeometryError, InputError, counted, warn
from ttus_opt.core.html_card import card, sections_svg
from ttus_opt.probe.even_sampling import (
    FINE,
    SurfaceSamples,
    dense_samples,
    match_moments,
    sphere_lattice,
    spread_evenly,
)
from ttus_opt.probe.mesh import (
    SUFFIXES,
    TriangleMesh,
    read_mesh,
    require_plausible_extent,
)
from ttus_opt.probe.orientation import largest_hole, orient_faces

Seed = int | np.random.Generator

SurfaceChoice = Literal["outer", "all", "hull"]

#: Faces with less exposure are inner walls or the sides of narrow grooves; from 0.25 to
#: 0.4 the outer area of a real probe's housing changes by 3 % [–]
LEAST_EXPOSURE = 1 / 3

#: Most points of a shell
MOST_POINTS = 1_000_000

#: |∫ n̂ dA| over the area above which a surface is called open.
OPEN_SHARE = 0.02


@dataclass(frozen=True, eq=False)
class PointShell:
    """Surface points of a probe.

    Attributes:
        points: Probe frame, shape (M, 3) [m].
        normals: Unit, pointing INTO the probe, shape (M, 3) [–].
        areas: Share of the surface, shape (M,) [m²].
        reference: Torques are about this point, the area centroid, probe frame,
            shape (3,) [m].
    """

    points: Array = field(repr=False)
    normals: Array = field(repr=False)
    areas: Array = field(repr=False)
    reference: Array

    def __post_init__(self) -> None:
        """Validate the shell.

        Raises:
            InputError: Shapes that disagree, values that are not finite, normals
                that are not unit vectors, or fewer than 4 points.
            GeometryError: An area that is not positive.
        """
        m = len(self.points)
        shapes = {"points": (m, 3), "normals": (m, 3), "areas": (m,), "reference": (3,)}
        hold_numbers(self, "shell", *shapes)
        for name, shape in shapes.items():
            value = getattr(self, name)
            expect_shape(value, shape, f"shell {name}")
            if not np.isfinite(value).all():
                raise InputError(f"shell {name} must be finite, got NaN or infinity")
        if m < 4:
            raise InputError(f"a shell needs at least 4 points, got {m}")
        lengths = np.linalg.norm(self.normals, axis=1)
        if np.abs(lengths - 1.0).max() > 1e-6:
            raise InputError(
                "shell normals must be unit vectors, got lengths "
                f"{lengths.min():.4g} to {lengths.max():.4g}: normalise them"
            )
        if not self.areas.min() > 0:
            raise GeometryError(
                f"shell areas must be positive [m²], got {self.areas.min():.4g}: a "
                "probe of zero area?"
            )

    def __len__(self) -> int:
        """Number of points M [–]."""
        return len(self.points)

    def __repr__(self) -> str:
        return f"PointShell({', '.join(self._facts().values())})"

    def _repr_html_(self) -> str:
        from scipy.spatial import ConvexHull

        sides = [1e3 * self.points[:, [axis, 2]] for axis in (0, 1)]  # [mm]
        outlines = [
            side[ConvexHull(side, qhull_options="QJ").vertices] for side in sides
        ]
        drawn = {"drawn": "outlines along y (dark) and along x, z upwards"}
        return card("PointShell", self._facts() | drawn, sections_svg(outlines))

    def _facts(self) -> dict[str, str]:
        """A short description, by name."""
        size = " × ".join(f"{1e3 * v:.0f}" for v in np.ptp(self.points, axis=0))
        return {
            "points": f"{len(self)} points",
            "size": f"{size} mm",
            "area": f"{1e4 * self.total_area:.4g} cm²",
        }

    @property
    def total_area(self) -> float:
        """Area of the surface [m²]."""
        return float(self.areas.sum())

    @property
    def rms_radius(self) -> float:
        """Root-mean-square distance from the reference [m].

        √(Σ a |x − x_ref|² / Σ a): the default characteristic length ℓ of torques.
        """
        square = ((self.points - self.reference) ** 2).sum(axis=1)
        return math.sqrt(float(self.areas @ square) / self.total_area)

    @classmethod
    def from_mesh(
        cls,
        path: str | os.PathLike[str],
        n_points: int = 1500,
        *,
        unit: str = "mm",
        surface: SurfaceChoice = "outer",
        seed: Seed = 0,
    ) -> PointShell:
        """Sample a mesh file; it need not be closed nor consistently wound.

        Args:
            path: STL, PLY or OBJ.
            n_points: Number of points M, at least 4 [–].
            unit: Unit of length of the file: m, cm, mm or in.
            surface: "outer" leaves out faces that cannot touch (the inner walls of a
                housing); "all" keeps every face; "hull" takes the convex hull, for
                a housing whose contact face is missing.
            seed: Seed of the sampling; the same seed gives the same shell.

        Returns:
            The shell in the file's frame.

        Raises:
            FileError: Missing or unreadable file.
            InputError: Unknown unit or surface, or too few points.
            GeometryError: No area, no inside, or not the size of a probe.
        """
        mesh = read_mesh(path, unit=unit)
        return _from_mesh(mesh, n_points, surface, seed)

    @classmethod
    def from_triangles(
        cls,
        vertices: Array,
        faces: NDArray[np.int64],
        n_points: int = 1500,
        *,
        surface: SurfaceChoice = "outer",
        seed: Seed = 0,
    ) -> PointShell:
        """Sample a triangle mesh in memory.

        Args:
            vertices: Shape (n, 3) [m].
            faces: Vertex indices, shape (k, 3) [–].
            n_points: As in `from_mesh`, like ``surface`` and ``seed``.
            surface: "outer", "all" or "hull".
            seed: Seed of the sampling.

        Raises:
            InputError: Arrays that are not a mesh, or too few points.
            GeometryError: No area, no inside, or not the size of a probe.
        """
        mesh = TriangleMesh(
            np.asarray(vertices, float), np.asarray(faces, np.int64)
        ).cleaned()
        require_plausible_extent(mesh.extent, "the probe")
        return _from_mesh(mesh, n_points, surface, seed)

    @classmethod
    def ellipsoid(
        cls,
        semi_axes: tuple[float, float, float],
        n_points: int = 1500,
        *,
        seed: Seed = 0,
    ) -> PointShell:
        """An ellipsoid about the origin, with exact normals.

        Args:
            semi_axes: Half lengths along x, y and z [m].
            n_points: Number of points M, at least 4 [–].
            seed: Seed of the sampling.

        Raises:
            InputError: Lengths that are not three positive numbers, or too few
                points.
            GeometryError: Not the size of a probe.
        """
        axes = _lengths(semi_axes, 3, "ellipsoid semi-axes")
        expect_whole(n_points, 4, MOST_POINTS, "n_points")
        require_plausible_extent(2.0 * axes.max(), "the probe", in_a_unit=False)
        given = tuple(axes.tolist()), n_points, seed
        known = isinstance(seed, int)  # a generator goes on
        even = _on_ellipsoid(*given) if known else _on_ellipsoid.__wrapped__(*given)
        points, areas = even.points.copy(), even.areas.copy()  # others have them too
        return cls(points, -even.normals, areas, np.zeros(3))

    @classmethod
    def sphere(
        cls, radius: float, n_points: int = 1500, *, seed: Seed = 0
    ) -> PointShell:
        """A sphere about the origin of the given radius [m]; see `ellipsoid`."""
        (r,) = _lengths((radius,), 1, "sphere radius")
        return cls.ellipsoid((r, r, r), n_points, seed=seed)

    @classmethod
    def box(
        cls,
        sizes: tuple[float, float, float],
        n_points: int = 1500,
        *,
        seed: Seed = 0,
    ) -> PointShell:
        """A box about the origin, full edges along x, y and z [m]; see `ellipsoid`."""
        edges = _lengths(sizes, 3, "box sizes")
        expect_whole(n_points, 4, MOST_POINTS, "n_points")
        require_plausible_extent(edges.max(), "the box", in_a_unit=False)
        signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3, indexing="ij"), axis=-1)
        mesh = TriangleMesh(signs.reshape(8, 3) * edges, np.arange(3)[None])
        shell = _from_outward_mesh(
            mesh.convex_hull(), n_points, np.random.default_rng(seed)
        )
        return cls(shell.points, shell.normals, shell.areas, np.zeros(3))

    @classmethod
    def from_spec(
        cls,
        spec: str | os.PathLike[str],
        n_points: int = 1500,
        *,
        unit: str = "mm",
        surface: SurfaceChoice = "outer",
        seed: Seed = 0,
    ) -> PointShell:
        """A probe from its description on the command line.

        Args:
            spec: ``ellipsoid:a,b,c`` (semi-axes), ``sphere:r``, ``box:a,b,c`` (full
                edges), all [m], or else the path of a mesh.
            n_points: Number of points M, at least 4 [–].
            unit: Unit of a mesh file, as in `from_mesh`; primitives are in metres.
            surface: Which faces of a mesh file to use, as in `from_mesh`.
            seed: Seed of the sampling.

        Raises:
            FileError: Missing or unreadable mesh.
            InputError: An invalid primitive.
            GeometryError: No area, or not the size of a probe.

        Examples:
            >>> shell = PointShell.from_spec("sphere:0.02", n_points=100)
            >>> len(shell), round(shell.rms_radius, 6)
            (100, 0.02)
        """
        text = os.fspath(spec)
        kind, colon, numbers = text.partition(":")
        builders: dict[str, tuple[int, Callable[..., PointShell]]] = {
            "ellipsoid": (3, cls.ellipsoid),
            "sphere": (1, cls.sphere),
            "box": (3, cls.box),
        }
        if kind not in builders:
            looks_like_file = os.path.exists(text) or text.lower().endswith(SUFFIXES)
            if colon and not looks_like_file:
                raise _bad_spec(text)
            return cls.from_mesh(text, n_points, unit=unit, surface=surface, seed=seed)
        count, build = builders[kind]
        try:
            values = tuple(float(v) for v in numbers.split(","))
        except ValueError:
            raise _bad_spec(text) from None
        if len(values) != count:
            raise _bad_spec(text)
        return build(values if count == 3 else values[0], n_points, seed=seed)


@functools.lru_cache(maxsize=32)
def _on_ellipsoid(
    semi_axes: tuple[float, float, float], n_points: int, seed: Seed
) -> SurfaceSamples:
    """Even points of an ellipsoid, a tenth of a second's work, kept for next time."""
    axes, rng = np.array(semi_axes), np.random.default_rng(seed)
    # an area element of the unit sphere grows by abc |D⁻¹u| on the ellipsoid
    lattice = sphere_lattice(max(FINE * n_points, 8000))
    unit = lattice[rng.permutation(len(lattice))]
    growth = axes.prod() * np.linalg.norm(unit / axes, axis=1)
    area = ellipsoid_area(axes)
    dense = SurfaceSamples(
        unit * axes, _normalised(unit / axes), area * growth / growth.sum()
    )
    even = spread_evenly(dense, n_points)
    exact = SurfaceSamples(even.points, _normalised(even.points / axes**2), even.areas)
    return match_moments(exact, area, np.zeros(3), np.zeros(3))


def ellipsoid_area(semi_axes: Array) -> float:
    """Area of an ellipsoid [m²]: 4π abc R_G(a⁻², b⁻², c⁻²), semi-axes (3,) [m]."""
    from scipy.special import elliprg

    a, b, c = 1.0 / np.asarray(semi_axes, float) ** 2
    return float(4.0 * np.pi * np.prod(semi_axes) * elliprg(a, b, c))


def _from_mesh(
    mesh: TriangleMesh, n_points: int, surface: SurfaceChoice, seed: Seed
) -> PointShell:
    """The shell of a cleaned mesh; errors as `PointShell.from_triangles`."""
    expect_one_of(surface, get_args(SurfaceChoice), "surface")
    expect_whole(n_points, 4, MOST_POINTS, "n_points")
    rng = np.random.default_rng(seed)
    if surface == "hull":
        mesh = mesh.convex_hull()
    else:
        orientation = orient_faces(mesh, rng)
        mesh = mesh.flipped(orientation.flip)
        if surface == "outer":
            mesh = _outer(mesh, orientation.exposure)
    return _from_outward_mesh(mesh, n_points, rng)


def _from_outward_mesh(
    mesh: TriangleMesh, n_points: int, rng: np.random.Generator
) -> PointShell:
    even = spread_evenly(dense_samples(mesh, max(FINE * n_points, 8000), rng), n_points)
    moment = mesh.areas @ mesh.corners.mean(axis=1)
    even = match_moments(even, mesh.area, mesh.vector_areas.sum(axis=0), moment)
    return PointShell(even.points, -even.normals, even.areas, moment / mesh.area)


def _outer(mesh: TriangleMesh, exposure: Array) -> TriangleMesh:
    """The faces that can touch, with a warning if they leave a large opening."""
    keep = exposure >= LEAST_EXPOSURE
    if not keep.any():
        raise GeometryError(
            "no face of the mesh can be seen from outside: check the mesh, or use "
            "surface='all'"
        )
    outer = mesh.subset(keep)
    missing = outer.vector_areas.sum(axis=0)
    size = float(np.linalg.norm(missing))
    if size > OPEN_SHARE * outer.area:
        x, y, z = -missing / size
        warn(
            f"the probe's outer surface is open by {1e4 * size:.3g} cm² "
            f"({100 * size / outer.area:.1f} %) towards ({x:.2f}, {y:.2f}, {z:.2f}), "
            f"{_place_of_opening(outer)}: "
            "if its contact face is there, close the mesh or use surface='hull'; "
            "elsewhere, as where the cable leaves, it does not matter",
            2,
        )
    return outer


def _place_of_opening(mesh: TriangleMesh) -> str:
    """Where the largest hole of an outward mesh is, in words."""
    hole = largest_hole(mesh)
    if hole is None:
        return "in many small holes"
    low, high = mesh.corners.min(axis=(0, 1)), mesh.corners.max(axis=(0, 1))
    off = (hole - 0.5 * (low + high)) / np.maximum(0.5 * (high - low), 1e-9)
    axis = int(np.argmax(np.abs(off)))
    end = f"{'-+'[int(off[axis] > 0)]}{'xyz'[axis]}"
    x, y, z = 1e3 * hole
    return (
        f"with its largest hole around ({x:.0f}, {y:.0f}, {z:.0f}) mm, at the {end} end"
    )


def _normalised(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _lengths(values: tuple[float, ...], count: int, what: str) -> Array:
    array = np.asarray(values, dtype=float)
    if array.shape != (count,) or not (np.isfinite(array) & (array > 0)).all():
        raise InputError(
            f"{what} must be {counted(count, 'positive length')} [m], got {values}: a "
            "probe of zero or negative size has no area"
        )
    return array


def _bad_spec(text: str) -> InputError:
    return InputError(
        f"cannot read probe {text!r}: expected ellipsoid:a,b,c (semi-axes), sphere:r "
        "or box:a,b,c (full edges) in metres, or the path of an STL, PLY or OBJ file"
    )
