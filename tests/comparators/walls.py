"""A patient so large that it is a half-space under the probe: known answers."""

import functools

import numpy as np
import pytest

from ttus_opt.comparators.base import OneStiffness
from ttus_opt.core.arrays import Array
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.scan.surface import Surface

#: Radius of the patient; over a probe of 3 cm it bends by 0.01 mm [m]
RADIUS = 9.0

#: Edges of the block that is pressed [m]
BLOCK = (0.03, 0.02, 0.02)

#: Of the face that is pressed [m²], and how deep [m]
AREA, DEPTH = BLOCK[0] * BLOCK[1], 0.002


@functools.cache
def wall(n_theta: int = 720) -> Surface:
    """A cylinder of 9 m."""
    return Surface.from_radius(np.full((n_theta, 5), RADIUS), np.linspace(-0.2, 0.2, 5))


@functools.cache
def block(n_points: int = 600) -> PointShell:
    return PointShell.box(BLOCK, n_points=n_points)


def pressed(depth: float, half: float = BLOCK[2] / 2) -> tuple[Array, Array]:
    """Pose of a probe whose third axis points outwards, at a depth."""
    R = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    return R, np.array([RADIUS + half - depth, 0.0, 0.0])


def check_cap_of_a_ball(kind: type[OneStiffness]) -> None:
    """Pressure k d on a rigid body is k times the volume below the surface (Gauss)."""
    radius = 0.02
    made = kind(surface=wall(), shell=PointShell.sphere(radius, n_points=1200))
    for depth in (0.003, 0.008):
        unit, _ = made._unit_wrench(*pressed(depth, half=radius))
        cap = np.pi * depth**2 * (radius - depth / 3.0)
        assert unit[0] == pytest.approx(cap, rel=0.03)
        np.testing.assert_allclose(unit[1:3], 0.0, atol=0.02 * cap)
        np.testing.assert_allclose(unit[3:], 0.0, atol=0.02 * cap * radius)
