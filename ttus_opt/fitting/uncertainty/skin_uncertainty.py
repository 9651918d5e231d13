"""Map of the uncertainty of a press at every place of the skin.

At every node of a grid over the skin the probe is pressed in to one depth along the
skin's normal, in the mean orientation of the recordings relative to the skin. The
force's standard deviation is small where the patient was measured and large elsewhere.
"""

from __future__ import annotations

import numpy as np

from ttus_opt.contact.scene import Scene
from ttus_opt.contact.standing import depth_of, standing, usual_hold
from ttus_opt.core.arguments import expect_positive
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
    expect_positive(depth, "depth", "m")
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
    if name := uncertainty.potential.differs_in(field):
        raise InputError(
            f"the uncertainty belongs to a field with another {name}: pass its own "
            "field"
        )


def skin_nodes(surface: Surface, spacing: float) -> tuple[Array, Array]:
    """Angles [rad] and heights [m] of a grid over the skin, away from its ends.

    Raises:
        InputError: A spacing that is not positive, or a body too short for it.
    """
    expect_positive(spacing, "spacing", "m")
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
    surface, held = scene.voxmap.surface, _held(scene)
    hold = usual_hold(surface, scene.shell, held.rotation, held.position)
    rotation, place = standing(surface, scene.shell, hold, theta, z, depth)
    # a segment each: nothing slides
    time = np.arange(len(place), dtype=np.float64)
    return Trajectory(time, place, rotation, segment=np.arange(len(place)))


def usual_depth(scene: Scene) -> float:
    """Median depth of the probe's deepest point in contact [m]."""
    held, surface = _held(scene), scene.voxmap.surface
    return float(
        np.median(depth_of(surface, scene.shell, held.rotation, held.position))
    )


def _held(scene: Scene) -> Trajectory:
    """The poses in contact.

    Raises:
        InputError: There is none.
    """
    touching = scene.touching
    if not touching.any():
        raise InputError("presses at other places need a recording in contact")
    return scene.trajectory.select(touching)
