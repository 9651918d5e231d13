"""A patient so large that it is a half-space under the probe: known answers."""

import functools

import numpy as np

from ttus_opt.probe.point_shell import PointShell
from ttus_opt.scan.surface import Surface

#: Radius of the patient; over a probe of 3 cm it bends by 0.01 mm [m]
RADIUS = 9.0

#: Edges of the block that is pressed [m]
BLOCK = (0.03, 0.02, 0.02)

#: Of the face that is pressed [m²], and how deep [m]
AREA, DEPTH = BLOCK[0] * BLOCK[1], 0.002


@functools.cache
def wall(n_theta=720):
    """A cylinder of 9 m."""
    return Surface.from_radius(np.full((n_theta, 5), RADIUS), np.linspace(-0.2, 0.2, 5))


@functools.cache
def block(n_points=600):
    return PointShell.box(BLOCK, n_points=n_points)


def pressed(depth, half=BLOCK[2] / 2):
    """Pose of a probe whose third axis points outwards, at a depth."""
    R = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    return R, np.array([RADIUS + half - depth, 0.0, 0.0])
