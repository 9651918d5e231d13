"""One pose of the probe, felt: the rendered wrench, the contact, and what limits it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ttus_opt.contact.contact_size import patches_of
from ttus_opt.contact.scene_warnings import cut_off
from ttus_opt.contact.standing import depth_of
from ttus_opt.core.arrays import Array
from ttus_opt.haptic.field_wrench import FORCE_LIMIT, TORQUE_LIMIT
from ttus_opt.haptic.renderer import Renderer, Wrench
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.voxmap.field import PotentialField


@dataclass(frozen=True)
class Touch:
    """A pose and what is felt there.

    Attributes:
        rotation: Probe to patient, shape (3, 3) [–].
        position: Origin of the probe frame, patient frame, shape (3,) [m].
        reference: The shell's reference point, patient frame, shape (3,) [m].
        wrench: What the renderer gives.
        depth: Depth of the probe's deepest point, negative in air [m].
        contact_length: Length of the contact patch, 0 in air [m].
        centre: Centre of the patch, patient frame; the reference point in air, (3,)
            [m].
        notes: What limits the force, a line each; empty where nothing does.
    """

    rotation: Array = field(repr=False)
    position: Array
    reference: Array = field(repr=False)
    wrench: Wrench
    depth: float
    contact_length: float
    centre: Array = field(repr=False)
    notes: tuple[str, ...]


def touch_at(
    renderer: Renderer,
    potential: PotentialField,
    shell: PointShell,
    pose: tuple[Array, Array],
    *,
    twist: Array | None = None,
    time: float | None = None,
) -> Touch:
    """Render one pose.

    Args:
        renderer: Of the field and the probe.
        potential: The field that it renders now.
        shell: The probe.
        pose: Rotation (3, 3) [–] and position (3,) [m].
        twist: As for `Renderer.render`.
        time: As for `Renderer.render` [s].
    """
    rotation, position = pose
    wrench = renderer.render(rotation, position, twist, time=time)
    voxmap, one = potential.voxmap, (rotation[None], position[None])
    depth = float(depth_of(voxmap.surface, shell, *one)[0])
    patch = patches_of(voxmap, shell, *one)
    reference = position + rotation @ shell.reference
    centre = reference + patch.centre[0]
    beyond = bool(cut_off(voxmap, shell, *one)[0])
    return Touch(
        rotation,
        position,
        reference,
        wrench,
        depth,
        float(np.sqrt(12.0 * patch.spread[0])),
        centre,
        _notes(wrench, potential, centre, depth, beyond),
    )


def _notes(
    wrench: Wrench, potential: PotentialField, centre: Array, depth: float, beyond: bool
) -> tuple[str, ...]:
    """What limits a wrench, in words."""
    out = []
    if depth > 0.0 and (not wrench.in_grid or wrench.contact_points == 0):
        out.append("beyond the model: nothing pushes back here")
    elif beyond:
        out.append("part of the contact lies beyond the model, nothing pushes it back")
    if wrench.limited_by == "force":
        out.append(f"scaled down to the renderer's limit of {FORCE_LIMIT:g} N")
    if wrench.limited_by == "torque":
        out.append(f"scaled down to the renderer's limit of {TORQUE_LIMIT:g} N m")
    if wrench.limited_by == "end":
        out.append("at an end of the model, where the force fades to zero")
    if wrench.beyond_inner > 0:
        out.append("deeper than the model: its innermost values go on from here")
    if depth > 0.0:
        x, y, z = centre
        angle = np.array([np.arctan2(y, x)])
        if not potential.voxmap.surface.seen_at(angle, np.array([z]))[0]:
            out.append("the scan did not see the skin here, it is filled in")
    return tuple(out)
