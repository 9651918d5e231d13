"""Simulated depth cameras: pixel by pixel, from geometry alone.

It shares nothing with the package but the numbers of the intrinsics.
"""

from dataclasses import dataclass

import numba
import numpy as np


@dataclass(frozen=True)
class Camera:
    """A pinhole camera without distortion, looking from an eye at a target."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    shape: tuple[int, int] = (120, 160)
    focal: float = 150.0
    down: tuple[float, float, float] = (0.0, -1.0, 0.0)

    @property
    def matrix(self):
        height, width = self.shape
        f = self.focal
        return np.array(
            [[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1.0]]
        )

    @property
    def pose(self):
        """Camera to scan, shape (4, 4)."""
        forward = np.subtract(self.target, self.eye)
        forward = forward / np.linalg.norm(forward)
        right = np.cross(self.down, forward)
        right /= np.linalg.norm(right)
        out = np.eye(4)
        out[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
        out[:3, 3] = self.eye
        return out

    @property
    def rays(self):
        """Directions in the scan with z = 1 in the camera, shape (h, w, 3)."""
        v, u = np.indices(self.shape, dtype=float)
        K = self.matrix
        own = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]], axis=-1)
        own = np.concatenate([own, np.ones((*self.shape, 1))], axis=-1)
        return own @ self.pose[:3, :3].T


def see_ellipsoid(camera, centre, semi_axes):
    """Depth z of an ellipsoid along the scan's axes, inf where it is missed [m]."""
    eye = (np.array(camera.eye) - centre) / semi_axes
    ray = camera.rays / semi_axes
    a = (ray**2).sum(-1)
    b = ray @ eye
    c = eye @ eye - 1.0
    with np.errstate(invalid="ignore"):
        z = (-b - np.sqrt(b**2 - a * c)) / a
    return np.where(z > 0, z, np.inf)


def see_plane(camera, normal, offset):
    """Depth z of the plane n·x = offset, inf where it is missed [m]."""
    with np.errstate(divide="ignore"):
        z = (offset - normal @ np.array(camera.eye)) / (camera.rays @ normal)
    return np.where(z > 0, z, np.inf)


def see_mesh(camera, vertices, faces):
    """Depth z of a mesh, inf where it is missed [m]."""
    own = (vertices - camera.pose[:3, 3]) @ camera.pose[:3, :3]
    return np.asarray(_nearest(own[faces], camera.matrix, camera.shape))


@numba.njit(cache=False)
def _nearest(corners, K, shape):
    """Every pixel's ray against the triangles whose outline it may hit."""
    z = np.full(shape, np.inf)
    for t in range(len(corners)):
        a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
        if min(a[2], b[2], c[2]) < 0.05:
            continue
        e0, e1, e2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        f0, f1, f2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        u = K[0, 0] * corners[t, :, 0] / corners[t, :, 2] + K[0, 2]
        v = K[1, 1] * corners[t, :, 1] / corners[t, :, 2] + K[1, 2]
        for i in range(max(int(v.min()), 0), min(int(v.max()) + 2, shape[0])):
            for j in range(max(int(u.min()), 0), min(int(u.max()) + 2, shape[1])):
                x, y = (j - K[0, 2]) / K[0, 0], (i - K[1, 2]) / K[1, 1]
                # Möller-Trumbore with the eye at the origin and the ray (x, y, 1)
                p0, p1, p2 = y * f2 - f1, f0 - x * f2, x * f1 - y * f0
                det = e0 * p0 + e1 * p1 + e2 * p2
                if det == 0.0:
                    continue
                s = -(a[0] * p0 + a[1] * p1 + a[2] * p2) / det
                q0 = a[2] * e1 - a[1] * e2
                q1 = a[0] * e2 - a[2] * e0
                q2 = a[1] * e0 - a[0] * e1
                r = (x * q0 + y * q1 + q2) / det
                depth = (f0 * q0 + f1 * q1 + f2 * q2) / det
                if s >= 0 and r >= 0 and s + r <= 1 and 0 < depth < z[i, j]:
                    z[i, j] = depth
    return z


def flying(z, rng):
    """Depths with the pixels at jumps mixed from both sides."""
    pad = np.pad(z, 1, mode="edge")
    h, w = z.shape
    around = np.stack(
        [pad[1 + i : 1 + i + h, 1 + j : 1 + j + w] for i, j in
         ((0, 0), (0, 1), (1, 0), (0, -1), (-1, 0))]
    )  # fmt: skip
    low, high = around.min(0), around.max(0)
    jump = (high - low > 0.03) & np.isfinite(high)
    mixed = low + rng.random(z.shape) * np.where(jump, high - low, 0.0)
    return np.where(jump, mixed, z)


def measured(z, std, missing, rng):
    """Depths with noise of a standard deviation [m] and missing pixels, NaN."""
    noisy = z + std * rng.standard_normal(z.shape)
    lost = ~np.isfinite(z) | (rng.random(z.shape) < missing)
    return np.where(lost, np.nan, noisy)


def millimetres(depth):
    """As cameras write them: whole millimetres, 0 where there is nothing."""
    return np.nan_to_num(np.rint(1e3 * depth)).astype(np.uint16)
