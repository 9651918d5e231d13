"""A simulated depth camera and a reference surface, for the tests of the contour.

Deterministic by the rng it is given. It shares nothing with the package: visibility
is a z-buffer over dense surface samples, the true radius a section of the mesh.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from trimesh.intersections import mesh_plane


@dataclass(frozen=True)
class View:
    """One camera: the direction it looks along and its noise along that ray [m]."""

    direction: tuple[float, float, float]
    noise: float


def sample_mesh(vertices, faces, n, rng):
    """Uniform surface samples (n, 3) and their outward unit normals (n, 3)."""
    a, b, c = (vertices[faces[:, m]] for m in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1)
    pick = rng.choice(len(faces), size=n, p=area / area.sum())
    u, v = rng.random((2, n))
    flip = u + v > 1
    u[flip], v[flip] = 1 - u[flip], 1 - v[flip]
    points = a[pick] + u[:, None] * (b - a)[pick] + v[:, None] * (c - a)[pick]
    return points, cross[pick] / area[pick, None]


def bed_plane(centre, size, n, rng):
    """A bed (x and z span it) whose normal is +y: the body lies at greater y."""
    uv = rng.uniform(-0.5, 0.5, (n, 2)) * size
    points = centre + np.stack([uv[:, 0], np.zeros(n), uv[:, 1]], axis=1)
    return points, np.tile([0.0, 1.0, 0.0], (n, 1))


def see(points, normals, view, rng, *, pixel=0.003, least_cosine=0.2):
    """What an orthographic camera sees: a z-buffer, then noise along the ray.

    Samples on the far side hide behind the nearest of their pixel's neighbourhood
    (a pixel plus its eight neighbours, so that no far point shines through).
    """
    ray = np.asarray(view.direction, float)
    ray /= np.linalg.norm(ray)
    helper = np.eye(3)[np.argmin(np.abs(ray))]
    right = np.cross(ray, helper)
    right /= np.linalg.norm(right)
    uv = points @ np.stack([right, np.cross(ray, right)], axis=1)
    depth = points @ ray
    cell = np.floor((uv - uv.min(0)) / pixel).astype(int) + 1
    nearest = np.full(cell.max(0) + 2, np.inf)
    np.minimum.at(nearest, (cell[:, 0], cell[:, 1]), depth)
    shifts = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    around = np.min([np.roll(nearest, s, axis=(0, 1)) for s in shifts], axis=0)
    cosine = -(normals @ ray)
    slope = np.sqrt(1 / np.clip(cosine, 0.1, 1) ** 2 - 1)
    seen = (cosine > least_cosine) & (
        depth < around[cell[:, 0], cell[:, 1]] + 0.003 + 2 * pixel * slope
    )
    found = points[seen]
    return found + view.noise * rng.standard_normal(len(found))[:, None] * ray


def radius_by_section(vertices, faces, theta, z):
    """True radius (n_theta, n_z): outermost meeting of each ray with the mesh.

    The mesh is in the patient frame. NaN where a ray meets nothing.
    """
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    out = np.full((len(theta), len(z)), np.nan)
    for k, level in enumerate(z):
        cut = mesh_plane(mesh, [0.0, 0.0, 1.0], [0.0, 0.0, level])[:, :, :2]
        a, d = cut[:, 0], cut[:, 1] - cut[:, 0]
        for j, angle in enumerate(theta):
            e = np.array([np.cos(angle), np.sin(angle)])
            across = -e[1] * a[:, 0] + e[0] * a[:, 1]
            step = -e[1] * d[:, 0] + e[0] * d[:, 1]
            with np.errstate(divide="ignore", invalid="ignore"):
                s = -across / step
            ok = (s >= 0) & (s <= 1)
            r = (a[ok] + s[ok, None] * d[ok]) @ e
            if len(r) and r.max() > 0:
                out[j, k] = r.max()
    return out
