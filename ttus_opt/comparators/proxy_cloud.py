"""Proxy on a point cloud, 3 degrees of freedom.

One point of the probe, its tip, is the haptic interface point h. A proxy P stays on the
cloud: each step moves it within the tangent plane of the points around it to the
position nearest to h,

    P ← h + n (n·(c − h)),

with c and n the weighted mean and normal (smallest principal axis, outwards) of the
points near P. A spring gives the force f = k (P − h) where h lies below the plane.

Source: F. Rydén, H. J. Chizeck, A proxy method for real-time 3-DOF haptic rendering of
streaming point cloud data, IEEE Trans. Haptics 6 (2013) 257–267. There points within
radii r₁ < r₂ < r₃ of the proxy count; here their weights fall smoothly to zero within
one radius (A. Adamson, M. Alexa, Ray tracing point set surfaces, SMI 2003), so that the
force has no steps. By default the tip is the mean contact point of the recordings.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Unpack

import numpy as np
from scipy.spatial import cKDTree

from ttus_opt.comparators.base import Given, OneStiffness
from ttus_opt.comparators.contact_geometry import ContactGeometry
from ttus_opt.core.arguments import expect_positive
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.probe.trajectory import Trajectory

#: Steps of the proxy; the last is less than 0.01 mm
STEPS = 8

#: Fewest points for a plane; with fewer there is no contact [–]
FEWEST = 6

#: Radius of the weights, in mean distances of the cloud's points [–]
RADIUS_IN_SPACINGS = 3.0


class ProxyCloud(OneStiffness):
    """A point proxy on a cloud, one stiffness.

    Attributes:
        tip: The contact point, probe frame, shape (3,) [m]; None before a fit.
        radius: Radius of the weights of the cloud's points [m].
    """

    name = "proxy_cloud"
    summary = "3-DOF proxy on a point cloud (Rydén, Chizeck 2013)"
    stiffness_unit = "N/m"

    def __init__(
        self,
        *,
        tip: Sequence[float] | None = None,
        radius: float | None = None,
        **given: Unpack[Given],
    ) -> None:
        super().__init__(**given)
        self.tip = None if tip is None else np.asarray(tip, dtype=float)
        if self.tip is not None and self.tip.shape != (3,):
            raise InputError(f"tip must be a point (3,) [m], got {self.tip.shape}")
        self._tree = cKDTree(self.cloud)
        self.radius = _radius(self._tree) if radius is None else float(radius)
        expect_positive(self.radius, "radius", "m")

    def _fit(self, recording: Trajectory, force: Array) -> None:
        if self.tip is None:
            self.tip = mean_tip(self.geometry, recording)
        super()._fit(recording, force)

    def _unit_wrench(self, R: Array, at: Array) -> tuple[Array, int]:
        assert self.tip is not None
        interface = R @ self.tip + at
        pushed = self._proxy(interface) - interface
        if not pushed.any():
            return np.zeros(6), 0
        arm = R @ (self.tip - self.shell.reference)
        return np.concatenate([pushed, np.cross(arm, pushed)]), 1

    def _proxy(self, interface: Array) -> Array:
        """Final position of the proxy; the interface point itself without contact."""
        place = self.cloud[self._tree.query(interface)[1]]
        height = 0.0
        for _ in range(STEPS):
            plane = self._plane(place)
            if plane is None:
                return interface
            middle, normal = plane
            height = float(normal @ (middle - interface))
            place = interface + height * normal
        return place if height > 0.0 else interface

    def _plane(self, place: Array) -> tuple[Array, Array] | None:
        """Mean and outward normal of the points around a place; None without any."""
        near = self.cloud[self._tree.query_ball_point(place, self.radius)]
        if len(near) < FEWEST:
            return None
        square = ((near - place) ** 2).sum(axis=1) / self.radius**2
        weights = (1.0 - square) ** 2
        weights /= weights.sum()
        middle = weights @ near
        spread = near - middle
        _, axes = np.linalg.eigh((weights[:, None] * spread).T @ spread)
        normal = axes[:, 0]
        outward = float(normal[:2] @ middle[:2])  # the axis z is inside
        return middle, normal if outward > 0.0 else -normal


def mean_tip(geometry: ContactGeometry, recording: Trajectory) -> Array:
    """Shell point nearest to the mean contact point of a recording, (3,) [m].

    Raises:
        InputError: The probe touches in no frame.
    """
    shell, total, weight = geometry.shell, np.zeros(3), 0.0
    for R, at in zip(recording.rotation, recording.position, strict=True):
        touch = geometry.touch(R, at)
        if len(touch):
            share = touch.areas * touch.depth
            total += share @ shell.points[touch.index]
            weight += float(share.sum())
    if weight == 0.0:
        raise InputError(
            "the probe touches the surface in no frame: check the recordings' frame "
            "and unit, or give the tip"
        )
    return np.array(shell.points[cKDTree(shell.points).query(total / weight)[1]])


def _radius(tree: cKDTree) -> float:
    """`RADIUS_IN_SPACINGS` mean distances of neighbouring points [m]."""
    points = tree.data[:: max(1, tree.n // 2000)]
    nearest = np.asarray(tree.query(points, 5)[0])[:, -1]
    return RADIUS_IN_SPACINGS * float(np.quantile(nearest, 0.95))
