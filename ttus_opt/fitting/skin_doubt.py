"""Map of the uncertainty of a press at every place of the skin.

At every node of a grid over the skin the probe is pressed in to one depth, in the mean
orientation of the recordings relative to the skin. The force's standard deviation is
small where the patient was measured and large elsewhere.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from ttus_opt.arrays import Array
from ttus_opt.errors import InputError
from ttus_opt.fitting.doubt import Doubt
from ttus_opt.haptic.field_wrench import wrenches_along
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.scene import Scene
from ttus_opt.voxmap.doubt_map import DoubtMap
from ttus_opt.voxmap.field import PotentialField

#: Distance between nodes, depth of a press, and margin at both ends [m]
SPACING, DEPTH, END = 0.02, 0.008, 0.02

#: Bisections of the probe's distance from the axis, and half of its range [m]
BISECTIONS, REACH = 20, 0.1

#: Least force by which a standard deviation is divided [N]
LEAST_FORCE = 0.05


def doubt_map(
    doubt: Doubt,
    field: PotentialField,
    *,
    spacing: float = SPACING,
    depth: float = DEPTH,
) -> DoubtMap:
    """Map of the uncertainty of a press over the whole skin.

    Args:
        doubt: Uncertainty of the field.
        field: The fitted field.
        spacing: Distance between nodes [m].
        depth: Depth of every press [m].

    Raises:
        InputError: A number that is not positive, recordings without contact, a body
            too short for the spacing, presses deeper than draws are kept, or the
            uncertainty of another field.
    """
    require_own(doubt, field)
    if not (spacing > 0.0 and depth > 0.0):
        raise InputError(
            f"spacing and depth must be positive [m], got {spacing}, {depth}"
        )
    surface = doubt.scene.voxmap.surface
    around = 2.0 * np.pi * float(surface.radius.mean())
    n = max(round(around / spacing), 8)
    theta = np.arange(n) * 2.0 * np.pi / n
    low, high = float(surface.z[0]) + END, float(surface.z[-1]) - END
    if high - low < spacing:
        raise InputError(f"the body is too short for places every {spacing:g} m")
    z = np.linspace(low, high, 1 + int(np.ceil((high - low) / spacing)))
    presses = _presses(doubt.scene, theta, z, depth)
    stated = doubt.std(presses)
    if not stated.known.all():
        raise InputError(
            f"presses of {depth:g} m reach deeper than the saved draws: give doubt a "
            "larger depth"
        )
    std = stated.force_size
    force = np.linalg.norm(
        wrenches_along(field, doubt.scene.shell, presses).force, axis=1
    )
    relative = std / np.maximum(force, LEAST_FORCE)
    relative[force == 0.0] = relative.max()  # outside the grid's sector
    return DoubtMap(theta, z, relative.reshape(n, len(z)))


def require_own(doubt: Doubt, field: PotentialField) -> None:
    """Check that a field has the grid, surface and sampling of an uncertainty.

    Raises:
        InputError: One of them differs.
    """
    own = doubt.potential
    one, other = own.voxmap.surface, field.voxmap.surface
    alike = {
        "grid": own.voxmap.grid == field.voxmap.grid,
        "surface": one is other or np.array_equal(one.radius, other.radius),
        "sampling": own.sampling == field.sampling,
    }
    for name, same in alike.items():
        if not same:
            raise InputError(
                f"the doubt belongs to a field with another {name}: pass its own field"
            )


def _presses(scene: Scene, theta: Array, z: Array, depth: float) -> Trajectory:
    """One pose per node, θ outermost."""
    angle, height = (a.reshape(-1) for a in np.meshgrid(theta, z, indexing="ij"))
    rotation = _around(angle) * _usual(scene)
    outward = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    radius = scene.voxmap.surface.radius_at(angle, height)
    turned = np.einsum("tij,mj->tmi", rotation.as_matrix(), scene.shell.points)
    near, far = radius - REACH, radius + REACH
    for _ in range(BISECTIONS):
        middle = 0.5 * (near + far)
        place = middle[:, None] * outward
        place[:, 2] = height
        points = place[:, None] + turned
        own = np.hypot(points[..., 0], points[..., 1])
        skin = scene.voxmap.surface.radius_at(
            np.arctan2(points[..., 1], points[..., 0]), points[..., 2]
        )
        deep = (skin - own).max(axis=1) > depth
        near, far = np.where(deep, middle, near), np.where(deep, far, middle)
    place = far[:, None] * outward
    place[:, 2] = height
    # a segment each: nothing slides
    time = np.arange(len(place), dtype=np.float64)
    return Trajectory(time, place, rotation.as_matrix(), segment=np.arange(len(place)))


def _usual(scene: Scene) -> Rotation:
    """Mean orientation of the probe in contact, relative to the skin below it."""
    touching = scene.rows.contact_points > 0
    if not touching.any():
        raise InputError("a doubt map needs a recording in contact")
    held = scene.trajectory.select(touching)
    angle = np.arctan2(held.position[:, 1], held.position[:, 0])
    return (_around(angle).inv() * Rotation.from_matrix(held.rotation)).mean()


def _around(angle: Array) -> Rotation:
    """Rotations by an angle about z."""
    return Rotation.from_rotvec(angle[:, None] * np.array([0.0, 0.0, 1.0]))
