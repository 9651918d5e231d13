"""The torso as one ellipsoid with a fitted stiffness.

The surface is replaced by the ellipsoid |A (x − c)| = 1 that fits it best in least
squares of radial distance; a probe point pushes along the probe's normal by stiffness
times area times depth. The depth is the level 1 − q, q = |A (x − c)|, over its
gradient,

    d = (1 − q) q / |Aᵀ A (x − c)|,

exact for a sphere and to first order at the skin of every ellipsoid.

Source: R. Yeung, D. Black, S. E. Salcudean, Measurement and Potential Field-Based
Patient Modeling for Model-Mediated Tele-ultrasound (2025), which takes an ellipsoid as
the simplest patient. Points that were not seen are filled in and count less
(`Surface.radius_std`).
"""

from __future__ import annotations

from typing import Unpack

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ttus_opt.comparators.base import Given, OneStiffness
from ttus_opt.comparators.contact_geometry import wrench_of
from ttus_opt.core.arrays import Array

#: Most surface points that the ellipsoid is fitted to [–]
MOST_POINTS = 5000

#: Upper limit of semi-axes over the cloud's size: an open tube does not bound them [–]
LONGEST = 5.0


class EllipsoidTorso(OneStiffness):
    """An ellipsoid, one stiffness.

    Attributes:
        centre: Patient frame, shape (3,) [m].
        semi_axes: Shape (3,) [m].
        axes: Its frame to the patient's, shape (3, 3) [–].
    """

    name = "ellipsoid_torso"
    summary = "the torso as one ellipsoid, fitted stiffness (Yeung and others 2025)"

    def __init__(self, **given: Unpack[Given]) -> None:
        super().__init__(**given)
        self.centre, self.semi_axes, self.axes = fitted_ellipsoid(self.cloud)

    def depth(self, points: Array) -> Array:
        """Depth of points below the ellipsoid, shape (n,) [m]."""
        local = (points - self.centre) @ self.axes / self.semi_axes
        q = np.linalg.norm(local, axis=1)
        steep = np.linalg.norm(local / self.semi_axes, axis=1)
        # the centre has no direction: its depth is the shortest semi-axis
        steep = np.maximum(steep, 1e-12 / self.semi_axes.min())
        return np.asarray((1.0 - q) * np.maximum(q, 1e-12) / steep)

    def _unit_wrench(self, R: Array, at: Array) -> tuple[Array, int]:
        arm = (self.shell.points - self.shell.reference) @ R.T
        depth = np.maximum(self.depth(R @ self.shell.reference + at + arm), 0.0)
        forces = (depth * self.shell.areas)[:, None] * (self.shell.normals @ R.T)
        return wrench_of(forces, arm), int(np.count_nonzero(depth))


def fitted_ellipsoid(cloud: Array) -> tuple[Array, Array, Array]:
    """The ellipsoid that fits points best by radial distance.

    Args:
        cloud: Shape (n, 3) [m].

    Returns:
        Centre (3,) [m], semi-axes (3,) [m], and their directions as columns (3, 3).
    """
    points = cloud[:: -(-len(cloud) // MOST_POINTS)]
    middle = points.mean(axis=0)
    size = float(np.ptp(points, axis=0).max())
    _, _, principal = np.linalg.svd(points - middle, full_matrices=False)
    turn = principal.T * np.sign(np.linalg.det(principal))
    half = np.ptp((points - middle) @ turn, axis=0) / 2.0

    def parts(x: Array) -> tuple[Array, Array, Array]:
        axes = turn @ Rotation.from_rotvec(x[6:]).as_matrix()
        return middle + size * x[:3], size * np.exp(x[3:6]), axes

    def misfit(x: Array) -> Array:
        centre, semi, axes = parts(x)
        offset = points - centre
        q = np.linalg.norm(offset @ axes / semi, axis=1)
        return np.asarray(np.linalg.norm(offset, axis=1) * (1.0 - 1.0 / q) / size)

    start = np.concatenate([np.zeros(3), np.log(half / size), np.zeros(3)])
    low = np.repeat([-0.5, np.log(0.02), -1.5], 3)
    high = np.repeat([0.5, np.log(LONGEST), 1.5], 3)
    optimum = least_squares(misfit, np.clip(start, low, high), bounds=(low, high))
    return parts(optimum.x)
