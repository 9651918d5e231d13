"""The wrench of a field: one function of pose and twist, friction's drag included.

For a pose (R, x) and a twist (v, ω) of the probe frame's origin, force and torque on
the probe, about its shell's reference, patient axes:

    f = N(R, x) p + f_d,   τ = W(R, x) p + τ_d

with the contact rows N, W of `ttus_opt.contact.rows` (eqs. 6, 7) and the drag (f_d,
τ_d) of `ttus_opt.haptic.drag`, which depends on pose, twist and contact. At rest there
is no drag.

`wrenches_along` gives it for a whole recording, from the rows; `ttus_opt.Renderer` for
one pose, compiled, to rounding the same. `evaluate` judges by the first, `ttus-opt
render` writes the second, and the rows that a fit with friction explains its
measurements by are the same function, linear in what it seeks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ttus_opt.arrays import Array
from ttus_opt.contact.friction import Sliding
from ttus_opt.contact.rows import ContactRows, contact_rows
from ttus_opt.haptic.drag import ACTS_AT, AT_POINTS, DragLaw, drag_of
from ttus_opt.haptic.frame import touch, wrench_of
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.haptic.point_drag import add_point_drag
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.voxmap.field import PotentialField

#: The field has no drag; or its drag is of the twist that was given, of a twist
#: estimated from poses and times, or left out because the motion is not known
DragSource = Literal["none", "given", "estimated", "left out"]


@dataclass(frozen=True, slots=True)
class Wrench:
    """What the probe feels in one pose.

    Attributes:
        force: Force on the probe, patient axes, shape (3,) [N].
        torque: Torque about the shell's reference point, patient axes, (3,) [N·m].
        contact_points: Shell points inside the patient [–].
        in_grid: False when no shell point lies within the grid; the wrench is zero.
        beyond_inner: Points in contact beyond the inner layer, where the field
            continues with that layer's values [–].
        drag: Whether friction's drag is in the wrench: ``none`` for a field without,
            ``given`` and ``estimated`` by where the twist is from, ``left out`` for
            a field with drag and an unknown motion.
        saturated: Whether the force was cut to the renderer's limit.
        force_std: Standard deviation of the force as a `DoubtMap` has it; NaN for a
            renderer without one [N].
    """

    force: Array
    torque: Array
    contact_points: int
    in_grid: bool
    beyond_inner: int = 0
    drag: DragSource = "none"
    saturated: bool = False
    force_std: float = math.nan


@dataclass(frozen=True)
class FieldWrenches:
    """What the probe feels in every frame of a trajectory.

    Attributes:
        force: Drag included, patient axes, shape (T, 3) [N].
        torque: About the shell's reference, patient axes, shape (T, 3) [N·m].
        in_grid: False where no shell point lies within the grid, shape (T,).
        beyond_inner: Points in contact beyond the inner layer, shape (T,) [–].
    """

    force: Array = field(repr=False)
    torque: Array = field(repr=False)
    in_grid: NDArray[np.bool_] = field(repr=False)
    beyond_inner: NDArray[np.int64] = field(repr=False)


def wrenches_along(
    potential: PotentialField, shell: PointShell, trajectory: Trajectory
) -> FieldWrenches:
    """The wrench of a field in every frame of a trajectory, by its poses and twists.

    Args:
        potential: The field, its drag among its parameters.
        shell: The probe.
        trajectory: Poses over time.

    Raises:
        InputError: Unusable poses, or parameters that are no drag.
    """
    rows = contact_rows(
        potential.voxmap,
        shell,
        trajectory.rotation,
        trajectory.position,
        sampling=potential.sampling,
    )
    return wrenches_by_rows(rows, potential, shell, trajectory)


def wrenches_by_rows(
    rows: ContactRows,
    potential: PotentialField,
    shell: PointShell,
    trajectory: Trajectory,
) -> FieldWrenches:
    """The same where the trajectory's rows are there already.

    Args:
        rows: Contact rows of the trajectory, in the field's grid and sampling.
        potential: The field, its drag among its parameters.
        shell: The probe.
        trajectory: Poses over time.
    """
    p = potential.values.reshape(-1)
    wrench = np.concatenate([(m @ p).reshape(-1, 3) for m in (rows.N, rows.W)], axis=1)
    law = DragLaw.of(potential.parameters, potential.voxmap.grid)
    if law.active:
        wrench += _drags(law, potential, shell, trajectory, wrench)
    return FieldWrenches(wrench[:, :3], wrench[:, 3:], rows.in_grid, rows.beyond_inner)


def _drags(
    law: DragLaw,
    potential: PotentialField,
    shell: PointShell,
    trajectory: Trajectory,
    contact: Array,
) -> Array:
    """Drag of every frame, shape (T, 6) [N, N·m]."""
    sliding = Sliding.of(potential.voxmap, shell, trajectory)
    patch = np.concatenate([sliding.normal, sliding.arm], axis=1)
    twist, reference = trajectory.twist(), np.array(shell.reference)
    drag = np.empty_like(contact)
    R, at = np.empty((3, 3)), np.empty(3)
    for t in range(len(trajectory)):
        # copied: whatever an array's layout, nothing is compiled anew
        R[:], at[:] = trajectory.rotation[t], trajectory.position[t]
        drag_of(R, at, twist[t], reference, patch[t], contact[t], law.numbers, drag[t])
    if law.numbers[ACTS_AT] == AT_POINTS:
        _add_point_drags(law, potential, shell, trajectory, drag)
    return drag


def _add_point_drags(
    law: DragLaw,
    potential: PotentialField,
    shell: PointShell,
    trajectory: Trajectory,
    drag: Array,
) -> None:
    """Add the drag of the shell's points in every frame, as frames have it."""
    sampling, twist = potential.sampling, trajectory.twist()
    data = FrameData.of(
        potential.voxmap,
        shell,
        trilinear=sampling != "voxel-mean",
        by_size=sampling == "contact-size",
    )
    values = np.array(potential.values, dtype=np.float64, order="C").reshape(-1)
    R, at, wrench = np.empty((3, 3)), np.empty(3), np.empty(6)
    for t in range(len(trajectory)):
        R[:], at[:] = trajectory.rotation[t], trajectory.position[t]
        n = touch(R, at, data)[0]
        wrench_of(values, n, R, data, wrench)
        add_point_drag(R, twist[t], n, data, law.numbers, drag[t])
