"""Map of the uncertainty of a press at every place of the skin.

At every node of a grid over the skin the probe is pressed in to one depth along the
skin's normal, in the mean orientation of the recordings relative to the skin. The
force's standard deviation is small where the patient was measured and large elsewhere.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.uncertainty.field_uncertainty import Uncertainty
from ttus_opt.haptic.field_wrench import wrenches_along
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.uncertainty_map import UncertaintyMap

#: Distance between nodes, depth of a press, and margin at both ends [m]
SPACING, DEPTH, END = 0.02, 0.008, 0.02

#: Bisections of the probe's distance from the skin, and half of its range [m]
BISECTIONS, REACH = 20, 0.1

#: Half of the distance over which the skin's slope is taken: that of a probe [m]
SLOPE = 0.01

#: Least force by which a standard deviation is divided [N]
LEAST_FORCE = 0.05


def uncertainty_map(
    uncertainty: Uncertainty,
    field: PotentialField,
    *,
    spacing: float = SPACING,
    depth: float = DEPTH,
) -> UncertaintyMap:
    """Map of the uncertainty of a press over the whole skin.

    Args:
        uncertainty: Uncertainty of the field.
        field: The fitted field.
        spacing: Distance between nodes [m].
        depth: Depth of every press [m].

    Raises:
        InputError: A number that is not positive, recordings without contact, a body
            too short for the spacing, presses deeper than draws are kept, or the
            uncertainty of another field.
    """
    require_own(uncertainty, field)
    if not depth > 0.0:
        raise InputError(f"depth must be positive [m], got {depth}")
    theta, z = skin_nodes(uncertainty.scene.voxmap.surface, spacing)
    n = len(theta)
    angle, height = (a.ravel() for a in np.meshgrid(theta, z, indexing="ij"))
    presses = presses_at(uncertainty.scene, angle, height, depth)
    stated = uncertainty.std(presses)
    if not stated.known.all():
        raise InputError(
            f"presses of {depth:g} m reach deeper than the saved draws: give "
            "uncertainty a larger depth"
        )
    std = stated.force_size
    force = np.linalg.norm(
        wrenches_along(field, uncertainty.scene.shell, presses).force, axis=1
    )
    relative = std / np.maximum(force, LEAST_FORCE)
    relative[force == 0.0] = relative.max()  # outside the grid's sector
    return UncertaintyMap(theta, z, relative.reshape(n, len(z)))


def require_own(uncertainty: Uncertainty, field: PotentialField) -> None:
    """Check that a field has the grid, surface and sampling of an uncertainty.

    Raises:
        InputError: One of them differs.
    """
    own = uncertainty.potential
    one, other = own.voxmap.surface, field.voxmap.surface
    alike = {
        "grid": own.voxmap.grid == field.voxmap.grid,
        "surface": one is other or np.array_equal(one.radius, other.radius),
        "sampling": own.sampling == field.sampling,
    }
    for name, same in alike.items():
        if not same:
            raise InputError(
                f"the uncertainty belongs to a field with another {name}: pass its "
                "own field"
            )


def skin_nodes(surface: Surface, spacing: float) -> tuple[Array, Array]:
    """Angles [rad] and heights [m] of a grid over the skin, away from its ends.

    Raises:
        InputError: A spacing that is not positive, or a body too short for it.
    """
    if not spacing > 0.0:
        raise InputError(f"spacing must be positive [m], got {spacing}")
    n = max(round(2.0 * np.pi * float(surface.radius.mean()) / spacing), 8)
    low, high = float(surface.z[0]) + END, float(surface.z[-1]) - END
    if high - low < spacing:
        raise InputError(f"the body is too short for places every {spacing:g} m")
    z = np.linspace(low, high, 1 + int(np.ceil((high - low) / spacing)))
    return np.arange(n) * 2.0 * np.pi / n, z


def presses_at(scene: Scene, theta: Array, z: Array, depth: float) -> Trajectory:
    """A press along the normal at each of k places, held as in the recordings.

    Args:
        scene: Patient, probe and recordings.
        theta: Angles, shape (k,) [rad].
        z: Heights, shape (k,) [m].
        depth: Depth of the deepest point of the probe [m].

    Raises:
        InputError: Recordings without contact.
    """
    surface, frames = scene.voxmap.surface, skin_frames(scene.voxmap.surface, theta, z)
    rotation, outward = frames @ _usual(scene), frames[:, :, 0]
    radius = surface.radius_at(theta, z)
    skin = np.stack([radius * np.cos(theta), radius * np.sin(theta), z], axis=1)
    turned = np.einsum("tij,mj->tmi", rotation, scene.shell.points)
    near, far = np.full(len(z), -REACH), np.full(len(z), REACH)
    for _ in range(BISECTIONS):
        middle = 0.5 * (near + far)
        place = skin + middle[:, None] * outward
        deep = _depths(surface, place[:, None] + turned) > depth
        near, far = np.where(deep, middle, near), np.where(deep, far, middle)
    place = skin + far[:, None] * outward
    # a segment each: nothing slides
    time = np.arange(len(place), dtype=np.float64)
    return Trajectory(time, place, rotation, segment=np.arange(len(place)))


def usual_depth(scene: Scene) -> float:
    """Median depth of the probe's deepest point in contact [m]."""
    held = _held(scene)
    turned = np.einsum("tij,mj->tmi", held.rotation, scene.shell.points)
    points = held.position[:, None] + turned
    return float(np.median(_depths(scene.voxmap.surface, points)))


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
        r = surface.radius_at(a, h)
        ends.append(np.stack([r * np.cos(a), r * np.sin(a), h], axis=1))
    normal = np.cross(ends[1] - ends[0], ends[3] - ends[2])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    around = np.cross([0.0, 0.0, 1.0], normal)
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    return np.stack([normal, around, np.cross(normal, around)], axis=2)


def _depths(surface: Surface, points: Array) -> Array:
    """Depth of the deepest of the points of every pose, (T, m, 3), shape (T,) [m]."""
    x, y, z = np.moveaxis(points, -1, 0)
    depth = surface.radius_at(np.arctan2(y, x), z) - np.hypot(x, y)
    return np.asarray(depth.max(axis=1))


def _held(scene: Scene) -> Trajectory:
    """The poses in contact.

    Raises:
        InputError: There is none.
    """
    touching = scene.rows.contact_points > 0
    if not touching.any():
        raise InputError("presses at other places need a recording in contact")
    return scene.trajectory.select(touching)


def _usual(scene: Scene) -> Array:
    """Mean orientation of the probe in contact, relative to the skin, (3, 3)."""
    held = _held(scene)
    x, y, z = held.position.T
    frames = skin_frames(scene.voxmap.surface, np.arctan2(y, x), z)
    own = Rotation.from_matrix(frames).inv() * Rotation.from_matrix(held.rotation)
    return np.asarray(own.mean().as_matrix())
