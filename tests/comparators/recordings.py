"""Presses and a slide on the small torso, with forces of a power law and drag."""

import functools

import numpy as np
from scipy.spatial.transform import Rotation

from tests.kit import ellipsoid, torso
from ttus_opt.comparators import create
from ttus_opt.comparators.contact_geometry import ContactGeometry
from ttus_opt.probe.trajectory import Trajectory

#: Force of a depth: 900 d^1.5 in N and cm, and Coulomb drag
STIFFNESS, EXPONENT, DRAG = 900.0, 1.5, 0.2

#: A coarse grid for the potential fields
COARSE = {"shape": (14, 32, 16)}

FIELDS = {"depth_map", "depth_map_coulomb", "eq10", "laplace_only", "tuned"}


def options(name):
    """What makes a comparator quick."""
    return COARSE if name in FIELDS else {}


def facing(surface, angle, z, depth):
    """Pose of the ellipsoid with its third axis along the spoke."""
    out = np.array([np.cos(angle), np.sin(angle), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    rotation = np.stack([up, np.cross(-out, up), -out], axis=1)
    radius = float(surface.radius_at(np.array(angle), np.array(z)))
    return rotation, (radius + 0.015 - depth) * out + z * up


def with_forces(trajectory, surface):
    """Forces of the power law at the deepest point, with drag."""
    geometry, wrench = ContactGeometry(surface, ellipsoid()), []
    moving = trajectory.velocity()
    for R, at, v in zip(trajectory.rotation, trajectory.position, moving, strict=True):
        patch = geometry.touch(R, at).patch
        size = STIFFNESS * patch.depth**EXPONENT * 10.0
        across = v - (v @ patch.direction) * patch.direction
        drag = -DRAG * size * across / max(float(np.linalg.norm(across)), 1e-3)
        force = size * patch.unit[:3] + drag
        torque = size * patch.unit[3:] + np.cross(patch.arm, drag)
        wrench.append(np.concatenate([force, torque]))
    rows = np.array(wrench)
    return Trajectory(
        trajectory.time,
        trajectory.position,
        trajectory.rotation,
        rows[:, :3],
        rows[:, 3:],
    )


def poses(places, surface):
    """Poses at (angle, z, depth), 20 Hz."""
    found = [facing(surface, *place) for place in places]
    tilt = Rotation.from_rotvec([0.05, -0.08, 0.03]).as_matrix()
    rotation = np.array([R @ tilt for R, _ in found])
    position = np.array([at for _, at in found])
    return Trajectory(np.arange(len(found)) * 0.05, position, rotation)


@functools.cache
def recordings():
    """Eight presses and a slide."""
    surface = torso()
    bell = 0.008 * np.sin(np.linspace(0.0, np.pi, 12)) - 0.0005
    spots = [(0.9 + 0.4 * (i % 4), 0.07 + 0.06 * (i // 4)) for i in range(8)]
    press = [(angle, z, float(d)) for angle, z in spots for d in bell]
    slide = [
        (1.2 + 0.3 * line, float(z), 0.005)
        for line in range(2)
        for z in np.linspace(0.06, 0.14, 30)
    ]
    return (
        with_forces(poses(press, surface), surface),
        with_forces(poses(slide, surface), surface),
    )


@functools.cache
def fitted(name):
    """A comparator fitted to both; shared, to be left as it is."""
    made = create(name, surface=torso(), shell=ellipsoid(), **options(name))
    return made.fit(recordings())
