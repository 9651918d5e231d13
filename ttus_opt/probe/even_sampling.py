"""Points spread evenly over a surface, each with its share of the area.

Three steps on a dense cloud of surface samples: farthest-point selection, a few
rounds of Lloyd's relaxation (every point moves to the sample nearest the centroid of
its cell), and the cells' areas and mean normals. Samples whose normals differ by
more than about a right angle are ignored, so the two sides of a thin wall are sampled
separately, and a cell never extends around a sharp edge.

Reference: Lloyd, Least squares quantization in PCM (1982), on a surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.compiled import compiled
from ttus_opt.core.errors import InputError
from ttus_opt.probe.mesh import TriangleMesh

#: Samples per point, to choose the points and to measure their areas
COARSE, FINE = 16, 64

#: Rounds of relaxation; on an ellipsoid more than 4 change nothing
ROUNDS = 4

#: Cosine below which two normals belong to different sheets: in farthest-point
#: selection, and in the assignment to cells (60°)
SAME_SHEET, SAME_CELL = -0.2, 0.5

#: Nearest seeds considered for a sample: first one, then, if that faces elsewhere, many
NEAREST, MANY = 1, 12

#: Fewest points whose areas are corrected for all 7 moments; below, for the total area
LEAST_FOR_MOMENTS = 50


@dataclass(frozen=True)
class SurfaceSamples:
    """Points of a surface with normals and areas, dense or even.

    Attributes:
        points: Shape (n, 3) [m].
        normals: Unit, outward, shape (n, 3) [–].
        areas: Share of the surface, shape (n,) [m²].
    """

    points: Array
    normals: Array
    areas: Array


def sphere_lattice(n: int) -> Array:
    """The Fibonacci lattice on the unit sphere, z falling, shape (n, 3) [–]."""
    i = np.arange(n) + 0.5
    z = 1.0 - 2.0 * i / n
    turn = 2.0 * np.pi * i * (math.sqrt(5.0) - 1.0) / 2.0
    ring = np.sqrt(1.0 - z**2)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)


def dense_samples(
    mesh: TriangleMesh, n_samples: int, rng: np.random.Generator
) -> SurfaceSamples:
    """Random samples of an outward mesh, of equal area and in random order."""
    # systematic sampling along the running area: a face never has more than one
    # sample too many or too few
    at = (np.arange(n_samples) + rng.random(n_samples)) / n_samples
    running = np.cumsum(mesh.areas)
    face = np.searchsorted(running, at * running[-1]).clip(max=len(running) - 1)
    root, v = np.sqrt(rng.random(n_samples)), rng.random(n_samples)
    weights = np.stack([1.0 - root, root * (1.0 - v), root * v], axis=1)
    shuffle = rng.permutation(n_samples)
    normals = mesh.vector_areas / mesh.areas[:, None]
    return SurfaceSamples(
        np.einsum("nc,ncd->nd", weights, mesh.corners[face])[shuffle],
        normals[face[shuffle]],
        np.full(n_samples, running[-1] / n_samples),
    )


def spread_evenly(samples: SurfaceSamples, n_points: int) -> SurfaceSamples:
    """Choose evenly spread points among dense samples.

    Args:
        samples: `FINE` · n_points of them or more, in random order.
        n_points: How many points.

    Returns:
        Points (samples themselves), the mean outward normals and the areas of their
        cells; the areas add up to the samples' area.

    Raises:
        InputError: Fewer than 4 points, or more points than samples.
    """
    if not 4 <= n_points <= len(samples.points):
        raise InputError(
            f"n_points must be between 4 and {len(samples.points)}, got {n_points}"
        )
    n_coarse = min(len(samples.points), max(COARSE * n_points, 2000))
    points = np.ascontiguousarray(samples.points[:n_coarse])
    normals = np.ascontiguousarray(samples.normals[:n_coarse])
    areas = samples.areas[:n_coarse]
    chosen = np.empty(n_points, np.int64)
    _farthest(chosen, np.full(n_coarse, np.inf), points, normals)
    for _ in range(ROUNDS):
        cell = _cells(points, normals, points[chosen], normals[chosen])
        middle = _sums(cell, points * areas[:, None], n_points)
        middle /= np.bincount(cell, weights=areas, minlength=n_points)[:, None]
        away = ((points - middle[cell]) ** 2).sum(axis=1)
        # the first sample of each cell when sorted by cell, then by distance
        order = np.lexsort((away, cell))
        chosen = order[np.searchsorted(cell[order], np.arange(n_points))]
    cell = _cells(samples.points, samples.normals, points[chosen], normals[chosen])
    shares = np.bincount(cell, weights=samples.areas, minlength=n_points).astype(float)
    mean = _sums(cell, samples.normals * samples.areas[:, None], n_points)
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    return SurfaceSamples(points[chosen], mean, shares)


def match_moments(
    even: SurfaceSamples, area: float, vector_area: Array, first_moment: Array
) -> SurfaceSamples:
    """Correct the areas by least squares, so that the sums are exact.

    Σ a = area, Σ a n̂ = vector area (zero for a closed surface: no net force under
    constant pressure) and Σ a x = first moment (the centroid). Below
    `LEAST_FOR_MOMENTS` points, or where an area would have to change by more than
    four fifths, only the total area is kept.

    Args:
        even: The points.
        area: Area of the surface [m²].
        vector_area: ∫ n̂ dA, shape (3,) [m²].
        first_moment: ∫ x dA, shape (3,) [m³].

    Returns:
        The same points and normals with corrected areas.
    """
    scaled = even.areas * (area / even.areas.sum())
    if len(scaled) >= LEAST_FOR_MOMENTS:
        centre = first_moment / area
        size = np.abs(even.points - centre).max()
        rows = np.vstack(
            [np.ones(len(scaled)), even.normals.T, (even.points - centre).T / size]
        )
        target = np.concatenate([[area], vector_area, np.zeros(3)])
        # a (1 + u), Σ a u² least: u = rowsᵀ y
        y = np.linalg.lstsq((rows * scaled) @ rows.T, target - rows @ scaled)[0]
        change = 1.0 + rows.T @ y
        if np.abs(change - 1.0).max() < 0.8:
            scaled = scaled * change
    return SurfaceSamples(even.points, even.normals, scaled)


def _sums(cell: IntArray, values: Array, n_points: int) -> Array:
    """Sums of vectors (n, 3) by cell, shape (n_points, 3)."""
    columns = [np.bincount(cell, weights=v, minlength=n_points) for v in values.T]
    return np.stack(columns, axis=1)


@compiled()
def _farthest(chosen: IntArray, distance: Array, points: Array, normals: Array) -> None:
    """Farthest-point selection, a new point never suppressing another sheet.

    ``distance`` is that of samples from the chosen points, initially infinite. No array
    is allocated here, which halves the time to compile.
    """
    n = len(points)
    current = 0
    for i in range(len(chosen)):
        chosen[i] = current
        x, y, z = points[current, 0], points[current, 1], points[current, 2]
        a, b, c = normals[current, 0], normals[current, 1], normals[current, 2]
        distance[current] = -1.0
        farthest = -1.0
        for m in range(n):
            dx, dy, dz = points[m, 0] - x, points[m, 1] - y, points[m, 2] - z
            d = dx * dx + dy * dy + dz * dz
            if d < distance[m]:
                cosine = normals[m, 0] * a + normals[m, 1] * b + normals[m, 2] * c
                if cosine > SAME_SHEET:
                    distance[m] = d
            if distance[m] > farthest:
                farthest = distance[m]
                current = m


def _cells(
    points: Array, normals: Array, seeds: Array, seed_normals: Array
) -> IntArray:
    """Index of the nearest seed on a sample's own sheet, shape (n,) [–].

    The first of the `MANY` nearest seeds whose normal is within 60°; without one (a
    detail smaller than the spacing), the seed with the most similar normal.
    """
    from scipy.spatial import KDTree

    tree = KDTree(seeds)
    cell = np.empty(len(points), dtype=np.int64)
    left = np.arange(len(points))
    for k in (NEAREST, MANY):  # one suffices for most samples
        count = min(k, len(seeds))
        near = np.asarray(tree.query(points[left], k=count)[1]).reshape(-1, count)
        cosine = np.einsum("nd,nkd->nk", normals[left], seed_normals[near])
        alike = cosine > SAME_CELL
        found = alike.any(axis=1)
        pick = np.where(found, alike.argmax(axis=1), cosine.argmax(axis=1))
        cell[left] = near[np.arange(len(left)), pick]
        left = left[~found]
        if not len(left) or count == len(seeds):
            break
    return cell
