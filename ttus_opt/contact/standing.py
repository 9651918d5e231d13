"""A probe that stands on the skin: its frame there, its depth, and poses of a depth.

A place (θ, z) of the skin has a frame: its outward normal, the direction around the
body and the one along it. A probe stands there when its shell's reference point lies on
the normal through the place, which the origin of its frame, a tracker's marker perhaps,
need not. It is held in some orientation relative to that frame and shifted along the
normal until its deepest point lies at the depth asked for.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.scan.surface import Surface

#: Half of the distance over which the skin's slope is taken: that of a probe [m]
SLOPE = 0.01

#: Poses end within this of the depth asked for, or after so many steps [m], [–]
TOLERANCE, STEPS = 1e-7, 40

#: Range of the depth's change per shift along the normal: where another point becomes
#: the deepest, a secant may have any slope [–]
RATES = 0.5, 2.0

#: The deepest point is one of those less than this above the lowest [m]: it is another
#: only on skin with a radius of curvature below w²/2 of this, w half the probe's width
REACH = 0.02

#: Most steps to the place below a point; each leaves the point's height over the skin's
#: radius of curvature of the distance [–]
FEET = 12

#: Poses whose points are placed together, which limits the memory [–]
TOGETHER = 500


def skin_frames(surface: Surface, theta: Array, z: Array) -> Array:
    """Outward normal, direction around and direction along, in columns, (k, 3, 3)."""
    step = SLOPE / surface.radius_at(theta, z)
    ends = []
    for a, h in (
        (theta - step, z),
        (theta + step, z),
        (theta, z - SLOPE),
        (theta, z + SLOPE),
    ):
        ends.append(skin_points(surface, a, h))
    normal = np.cross(ends[1] - ends[0], ends[3] - ends[2])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    around = np.cross([0.0, 0.0, 1.0], normal)
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    return np.stack([normal, around, np.cross(normal, around)], axis=2)


def skin_points(surface: Surface, theta: Array, z: Array) -> Array:
    """The skin at places of any shape, shape (…, 3) [m]."""
    radius = surface.radius_at(theta, z)
    return np.stack([radius * np.cos(theta), radius * np.sin(theta), z], axis=-1)


def places_below(surface: Surface, points: Array) -> tuple[Array, Array]:
    """Places whose normals go through points near the skin.

    Args:
        surface: The skin.
        points: Patient frame, shape (k, 3) [m].

    Returns:
        Angles [rad] and heights [m], shape (k,).
    """
    foot = points
    for _ in range(FEET):
        theta, z = np.arctan2(foot[:, 1], foot[:, 0]), foot[:, 2]
        normal = skin_frames(surface, theta, z)[:, :, 0]
        above = np.einsum("ki,ki->k", points - skin_points(surface, theta, z), normal)
        last, foot = foot, points - above[:, None] * normal
        if np.abs(foot - last).max(initial=0.0) < TOLERANCE:
            break
    return np.arctan2(foot[:, 1], foot[:, 0]), foot[:, 2]


def depth_of(
    surface: Surface, shell: PointShell, rotation: Array, position: Array
) -> Array:
    """Depth of the probe's deepest point, negative in air.

    Args:
        surface: The skin.
        shell: The probe.
        rotation: Probe to patient, shape (k, 3, 3) [–].
        position: Origin of the probe frame, patient frame, shape (k, 3) [m].

    Returns:
        Shape (k,) [m].
    """
    return deepest(surface, shell, rotation, position)[0]


def deepest(
    surface: Surface, shell: PointShell, rotation: Array, position: Array
) -> tuple[Array, IntArray]:
    """Depth of the probe's deepest point, as `depth_of`, and its number, (k,)."""
    depth, point = np.empty(len(position)), np.empty(len(position), np.int64)
    for first in range(0, len(position), TOGETHER):
        part = slice(first, first + TOGETHER)
        turned = np.einsum("tij,mj->tmi", rotation[part], shell.points)
        every = surface.depth_of(position[part, None] + turned)
        depth[part], point[part] = every.max(axis=1), every.argmax(axis=1)
    return depth, point


def usual_hold(
    surface: Surface, shell: PointShell, rotation: Array, position: Array
) -> Array:
    """Mean orientation of a probe relative to the skin below it, shape (3, 3).

    Args:
        surface: The skin.
        shell: The probe.
        rotation: Of poses in contact, shape (k, 3, 3) [–].
        position: Their origins, shape (k, 3) [m].
    """
    references = position + rotation @ shell.reference
    frames = skin_frames(surface, *places_below(surface, references))
    turns = Rotation.from_matrix(frames).inv() * Rotation.from_matrix(rotation)
    return np.asarray(turns.mean().as_matrix())


def standing(
    surface: Surface,
    shell: PointShell,
    hold: Array,
    theta: Array,
    z: Array,
    depth: float,
) -> tuple[Array, Array]:
    """Poses of a probe that stands on the skin, its deepest point at a depth.

    Args:
        surface: The skin.
        shell: The probe.
        hold: Orientation relative to the skin's frame, shape (3, 3) [–].
        theta: Angles, shape (k,) [rad].
        z: Heights, shape (k,) [m].
        depth: Depth of the deepest point, negative in air [m].

    Returns:
        Rotations, (k, 3, 3) [–], and positions of the origin, (k, 3) [m].
    """
    frames, skin = skin_frames(surface, theta, z), skin_points(surface, theta, z)
    height = (shell.points - shell.reference) @ hold[0]
    low = shell.points[height < height.min() + REACH]
    rotation = frames @ hold
    reference = skin - (height.min() + depth) * frames[:, :, 0]
    position = reference - rotation @ shell.reference
    for first in range(0, len(z), TOGETHER):
        part = slice(first, first + TOGETHER)
        turned = np.einsum("tij,mj->tmi", rotation[part], low)
        shift, last = np.zeros(len(turned)), np.zeros(len(turned))
        rate = np.ones(len(turned))
        for _ in range(STEPS):
            excess = surface.depth_of(position[part, None] + turned).max(axis=1) - depth
            # a shift along the normal changes the depth by about as much: secants
            far = np.abs(shift) > TOLERANCE
            rate[far] = np.clip((last - excess)[far] / shift[far], *RATES)
            shift, last = excess / rate, excess
            position[part] += shift[:, None] * frames[part, :, 0]
            if np.abs(excess).max() < TOLERANCE:
                break
    return rotation, position
