"""The wrench of a field: one function of pose and twist, friction included.

For a pose (R, x) and a twist (v, ω) of the probe frame's origin, the force on the
probe and the torque about the shell's reference point are, in patient axes,

    f = N(R, x) p + f_d,   τ = W(R, x) p + τ_d

with the contact rows N, W of `ttus_opt.contact.rows` (eqs. 6, 7) and the drag (f_d,
τ_d) of `ttus_opt.haptic.drag`, which depends on pose, twist and contact. At rest there
is no drag, except that of `ttus_opt.haptic.presliding`, which depends on the motion of
all frames so far.

`wrenches_along` computes it for a whole recording, from the rows and the drag of such
frames; `ttus_opt.Renderer` for one pose. Both agree up to rounding and its limits:
these protect a hand and are no property of the patient, so `evaluate`, which uses the
first, judges the whole wrench and says how many frames a renderer would shorten.
`ttus-opt render` uses the second. The rows of a fit with friction are the same
function, linear in the unknowns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ttus_opt.contact.contact_size import Patches
from ttus_opt.contact.rows import ContactRows, contact_rows
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.haptic.drag import (
    ACTS_AT,
    AT_POINTS,
    PRESLIDING,
    DragLaw,
    drag_of,
)
from ttus_opt.haptic.frame import touch, wrench_of
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.haptic.motion import ways_along
from ttus_opt.haptic.point_drag import add_point_drag
from ttus_opt.haptic.presliding import (
    BRISTLE,
    add_presliding,
    bend,
    flank_of,
    strength_of,
)
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.voxmap.field import PotentialField

#: Largest force [N] and torque [N·m] of a renderer by default: 40 N at the end of a
#: lever of 10 cm, which a hand holds; a scan takes up to about 25 N
FORCE_LIMIT, TORQUE_LIMIT = 40.0, 4.0

#: What shortened a wrench: nothing, a limit of the renderer, an end of the grid
Limit = Literal["", "force", "torque", "end"]

#: No drag in the field; drag by a given twist; by a twist estimated from poses and
#: times; or left out because the motion is unknown
DragSource = Literal["none", "given", "estimated", "left out"]


@dataclass(frozen=True, slots=True, eq=False)
class Wrench:
    """Force and torque on the probe in one pose.

    Attributes:
        force: Force on the probe, patient axes, shape (3,) [N].
        torque: Torque about the shell's reference point, patient axes, (3,) [N·m].
        contact_points: Shell points inside the patient [–].
        in_grid: False when no shell point lies within the grid; the wrench is zero.
        beyond_inner: Points in contact beyond the inner layer, where the field
            continues with that layer's values [–].
        drag: Whether the wrench includes drag: ``none`` for a field without friction,
            ``given`` or ``estimated`` after the source of the motion, ``left out`` for
            a field with friction and an unknown motion. Friction with a presliding
            length takes it from the poses alone.
        limited_by: The renderer's limit to which the wrench was scaled down, as a whole
            and so with its direction kept: ``force``, ``torque``; "" for none. A
            wrench that is not finite is zero, ``force``. Without these, ``end`` tells
            of contact in the last voxel at an axial end of the grid, over which the
            force fades to zero.
        force_std: Standard deviation of the force by an `UncertaintyMap`; NaN without
            one [N].
    """

    force: Array
    torque: Array
    contact_points: int
    in_grid: bool
    beyond_inner: int = 0
    drag: DragSource = "none"
    limited_by: Limit = ""
    force_std: float = math.nan

    @property
    def saturated(self) -> bool:
        """Whether a limit of the renderer acted."""
        return self.limited_by in ("force", "torque")


@dataclass(frozen=True)
class FieldWrenches:
    """Force and torque on the probe in every frame of a trajectory.

    Attributes:
        force: Force on the probe, drag included, patient axes, shape (T, 3) [N].
        torque: About the shell's reference point, patient axes, shape (T, 3) [N·m].
        in_grid: False where no shell point lies within the grid, shape (T,).
        beyond_inner: Points in contact beyond the inner layer, shape (T,) [–].
    """

    force: Array = field(repr=False)
    torque: Array = field(repr=False)
    in_grid: NDArray[np.bool_] = field(repr=False)
    beyond_inner: NDArray[np.int64] = field(repr=False)


def checked_limits(force: float, torque: float) -> None:
    """`InputError` where a renderer's limit [N], [N·m] is not a positive number."""
    for limit, name, unit in ((force, "force", "N"), (torque, "torque", "N m")):
        if not (isinstance(limit, int | float) and limit > 0.0):
            raise InputError(
                f"{name}_limit must be positive [{unit}], math.inf for none, got "
                f"{limit}"
            )


def over_limits(force: Array, torque: Array) -> NDArray[np.bool_]:
    """Which wrenches (T, 3) [N], (T, 3) [N·m] a renderer scales down by default."""
    size, turn = (np.linalg.norm(one, axis=1) for one in (force, torque))
    return np.asarray((size > FORCE_LIMIT) | (turn > TORQUE_LIMIT))


def wrenches_along(
    potential: PotentialField, shell: PointShell, trajectory: Trajectory
) -> FieldWrenches:
    """The wrench of a field in every frame of a trajectory.

    Args:
        potential: The field, with drag among its parameters.
        shell: The probe.
        trajectory: Poses over time; twists are their differences.

    Raises:
        InputError: Unusable poses or drag parameters.
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
    """Like `wrenches_along`, from contact rows that are already assembled.

    Args:
        rows: Contact rows of the trajectory, in the field's grid and sampling.
        potential: The field, with drag among its parameters.
        shell: The probe.
        trajectory: Poses over time.
    """
    p = potential.values.reshape(-1)
    wrench = np.concatenate([(m @ p).reshape(-1, 3) for m in (rows.N, rows.W)], axis=1)
    law = DragLaw.of(potential.parameters, potential.voxmap.grid)
    if law.active:
        wrench += _drags(law, potential, shell, trajectory, wrench, rows.patches)
    return FieldWrenches(wrench[:, :3], wrench[:, 3:], rows.in_grid, rows.beyond_inner)


def _drags(
    law: DragLaw,
    potential: PotentialField,
    shell: PointShell,
    trajectory: Trajectory,
    contact: Array,
    patches: Patches,
) -> Array:
    """Drag of every frame, by a renderer's own code, shape (T, 6) [N, N·m]."""
    data = FrameData.of(potential.voxmap, shell, potential.sampling)
    values = np.array(potential.values, dtype=np.float64, order="C").reshape(-1)
    numbers, reference = law.numbers, np.array(shell.reference)
    at_points, presliding = numbers[ACTS_AT] == AT_POINTS, numbers[PRESLIDING] > 0.0
    ways = np.concatenate([np.zeros((1, 6)), ways_along(shell, trajectory)])
    begins = np.concatenate([[True], np.diff(trajectory.segment) != 0])
    patch = np.concatenate([patches.normal, patches.centre], axis=1)
    twist, drag = trajectory.twist(), np.zeros_like(ways)
    R, at, touched = np.empty((3, 3)), np.empty(3), 0
    bristle, scratch = np.zeros(BRISTLE), np.empty((2, 6))
    for t, felt in enumerate(contact):
        # copied, so that no array layout triggers a compilation
        R[:], at[:] = trajectory.rotation[t], trajectory.position[t]
        drag_of(R, at, twist[t], reference, patch[t], felt, numbers, drag[t])
        if at_points:
            touched = touch(R, at, data)[0]
            wrench_of(values, touched, R, data, scratch[0])
        if presliding:
            flank = flank_of(R, patch[t], touched, data, numbers, scratch)
            if begins[t]:
                bristle[:] = 0.0
            strength = strength_of(patch[t], felt, numbers)
            bend(bristle, tuple(ways[t]), R, patch[t], strength, flank, numbers)
            add_presliding(bristle, patch[t], felt, flank, numbers, drag[t])
        elif at_points:
            add_point_drag(R, twist[t], touched, data, numbers, drag[t])
    return drag
