"""The haptic renderer: one library call per frame, force and torque of a pose.

The same points, voxels and weights as the rows of the fit (`ttus_opt.contact`),
compiled (`ttus_opt.haptic_frame`): ``render(pose) == (N p, W p)`` to rounding. A new
field comes in while another thread renders (`Renderer.update`), blended so that it
neither jumps nor adds energy (`ttus_opt.haptic_blend`). Nothing here loads a modelling
package, a solver or a camera.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ttus_opt.compiled import compiled
from ttus_opt.contact import checked_poses
from ttus_opt.errors import InputError
from ttus_opt.field import PotentialField
from ttus_opt.haptic_blend import (
    PROGRESS,
    SEEN,
    BlendLaw,
    BlendState,
    advance,
    follow,
    opened_ledger,
    settled_ledger,
)
from ttus_opt.haptic_frame import touch, wrench_of
from ttus_opt.haptic_stage import Stage
from ttus_opt.point_shell import PointShell

Array = NDArray[np.float64]


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
    """

    force: Array
    torque: Array
    contact_points: int
    in_grid: bool
    beyond_inner: int


@dataclass(frozen=True, slots=True)
class _Fields:
    """What a frame renders, swapped as one: two fields and the ledger between them."""

    current: Array = field(repr=False)
    target: Array = field(repr=False)
    ledger: Array = field(repr=False)


class Renderer:
    """Renders contact of one probe with one field, and with the fields after it.

    One thread renders; any other may call `update`. A frame takes no lock that it
    would have to wait for: while an update prepares a swap, frames go on with the
    fields as they stand. Neither does it allocate, apart from the `Wrench` it
    returns; `render_into` spares that too. Compiled code runs without the interpreter's
    lock, here and in the fit; a thread busy in plain Python holds that lock for up to
    `sys.getswitchinterval`, so give such work a process of its own.

    Args:
        field: The fitted field.
        shell: The probe's point shell.
        blend: How updates come in; `BlendLaw`'s defaults when not given.
    """

    def __init__(
        self, field: PotentialField, shell: PointShell, *, blend: BlendLaw | None = None
    ) -> None:
        blend = blend or BlendLaw()
        self._field = field
        self._stage = Stage.of(
            field.voxmap, shell, trilinear=field.sampling == "trilinear"
        )
        self._limits = blend.kernel_limits(shell.rms_radius)
        values = _flat(field)
        self._fields = _Fields(values, values, settled_ledger(blend.reserve))
        # a pose is copied here: whatever its layout, it compiles nothing new
        self._rotation, self._position = np.eye(3), np.zeros(3)
        self._wrench, self._other = np.zeros(6), np.zeros(6)
        self._turn = threading.Lock()  # to change the ledger; frames only try it
        self._waiting = False  # an update wants the turn
        self._updates = threading.Lock()  # one update at a time
        self.warm_up()

    def warm_up(self) -> None:
        """Compile, so that no frame or update has to; called on construction."""
        self._trial()
        fields = self._fields
        ledger = settled_ledger(0.0)
        opened_ledger(ledger, fields.current, fields.target, self._stage)
        _mixed(fields.current[:4], fields.target[:4], 0.5)

    def _trial(self) -> int:
        """A frame amid a swap, on a ledger of its own."""
        ledger = settled_ledger(0.0)
        ledger[PROGRESS] = 0.5
        contact, _, _ = _frame(
            np.eye(3),
            np.zeros(3),
            self._stage,
            self._fields.current,
            self._fields.target,
            ledger,
            self._limits,
            True,
            self._other,
            self._wrench,
        )
        return int(contact)

    def render(self, rotation: Array, position: Array) -> Wrench:
        """Force and torque of one pose.

        Args:
            rotation: Probe to patient, shape (3, 3) [–].
            position: Of the probe frame's origin, patient frame, shape (3,) [m].

        Returns:
            The wrench, the caller's own; zero, and ``in_grid`` False, for a pose
            outside the grid.

        Raises:
            InputError: Wrong shapes, NaN, or no rotation matrix.
        """
        counts = self._render(rotation, position)
        wrench = self._wrench.copy()
        return Wrench(wrench[:3], wrench[3:], *counts)

    def render_into(self, rotation: Array, position: Array, out: Array) -> int:
        """The same frame into the caller's array: nothing is allocated.

        Args:
            rotation: Probe to patient, shape (3, 3) [–].
            position: Of the probe frame's origin, patient frame, shape (3,) [m].
            out: Force, then torque, shape (6,) [N, N·m]; written.

        Returns:
            Points in contact, or -1 when no shell point lies within the grid.

        Raises:
            InputError: Wrong shapes, NaN, or no rotation matrix.
        """
        if out.shape != (6,):
            raise InputError(f"out must have shape (6,), got {out.shape}")
        contact_points, in_grid, _ = self._render(rotation, position)
        out[:] = self._wrench
        return contact_points if in_grid else -1

    def _render(self, rotation: Array, position: Array) -> tuple[int, bool, int]:
        """Render one pose into ``_wrench``; what `_frame` returns."""
        if np.shape(rotation) != (3, 3) or np.shape(position) != (3,):
            raise InputError(
                "a pose needs rotation (3, 3) and position (3,) [m], got "
                f"{np.shape(rotation)} and {np.shape(position)}"
            )
        R, at = self._rotation, self._position
        R[:], at[:] = rotation, position
        turn = not self._waiting and self._turn.acquire(blocking=False)
        try:
            fields = self._fields
            counts = _frame(
                R,
                at,
                self._stage,
                fields.current,
                fields.target,
                fields.ledger,
                self._limits,
                turn,
                self._other,
                self._wrench,
            )
        finally:
            if turn:
                self._turn.release()
        if counts[0] < 0:
            checked_poses(R[None], at[None])  # says in words what is wrong
        return counts  # type: ignore[no-any-return]

    def update(self, field: PotentialField) -> None:
        """Swap in a new field, also while another thread renders.

        The swap is atomic and its effect gradual: force changes by no more than the
        law's rate, and the change adds no energy (`ttus_opt.haptic_blend`). A swap
        still under way goes over into this one from where it stands. Before the first
        frame nothing has been felt, so that the field is simply taken.

        Args:
            field: On the same grid and surface and with the same sampling.

        Raises:
            InputError: It is for another grid, surface or sampling.
        """
        self._require_alike(field)
        values, stage = _flat(field), self._stage.with_own_scratch()
        with self._updates:
            self._waiting = True
            try:
                with self._turn:
                    self._fields = self._swapped(values, stage)
            finally:
                self._waiting = False

    def _swapped(self, values: Array, stage: Stage) -> _Fields:
        """The fields after an update; only with the turn in hand."""
        now = self._fields
        if now.ledger[SEEN] == 0.0:
            return _Fields(values, values, now.ledger)
        share = float(now.ledger[PROGRESS])
        current = now.target if share == 1.0 else _mixed(now.current, now.target, share)
        ledger = opened_ledger(now.ledger, current, values, stage)
        return _Fields(current, values, ledger)

    def _require_alike(self, new: PotentialField) -> None:
        old = self._field
        for name, same in (
            ("sampling", new.sampling == old.sampling),
            ("grid", new.voxmap.grid == old.voxmap.grid),
            (
                "surface",
                new.voxmap.surface is old.voxmap.surface
                or np.array_equal(new.voxmap.surface.radius, old.voxmap.surface.radius),
            ),
        ):
            if not same:
                raise InputError(
                    f"an update must keep the field's {name}: make a new Renderer"
                )

    @property
    def blend(self) -> BlendState:
        """Where the last update's swap stands."""
        return BlendState.of(self._fields.ledger)


def _flat(field: PotentialField) -> Array:
    """A copy of the field's values, flat: nobody else's to change."""
    return np.array(field.values, dtype=np.float64, order="C").reshape(-1)


@compiled(nogil=True)
def _mixed(current: Array, target: Array, share: float) -> Array:
    """(1 − share) current + share target, without the interpreter's lock (compiled)."""
    out = np.empty_like(current)
    for m in range(out.size):
        out[m] = (1.0 - share) * current[m] + share * target[m]
    return out


@compiled()
def _is_rigid(R: Array, at: Array) -> bool:
    """Whether a pose is finite and its rotation orthonormal (compiled)."""
    for a in range(3):
        for b in range(3):
            dot = R[0, a] * R[0, b] + R[1, a] * R[1, b] + R[2, a] * R[2, b]
            # written so that NaN fails
            if not abs(dot - (1.0 if a == b else 0.0)) <= 1e-6:
                return False
    return math.isfinite(at[0] + at[1] + at[2])


@compiled(error_model="numpy", nogil=True)
def _frame(
    R: Array,
    at: Array,
    stage: Stage,
    current: Array,
    target: Array,
    ledger: Array,
    limits: Array,
    turn: bool,
    other: Array,
    wrench: Array,
) -> tuple[int, bool, int]:
    """One frame: touch, sum one field or two, blend, note the pose (compiled).

    Without the turn the ledger is read and not written.

    Returns:
        Points in contact, -1 for an unusable pose; whether the shell meets the grid;
        points in contact beyond the inner layer.
    """
    if not _is_rigid(R, at):
        return -1, False, 0
    contact, in_grid, beyond = touch(R, at, stage)
    wrench_of(target, contact, R, stage, wrench)
    if ledger[PROGRESS] == 1.0:
        if turn:
            follow(ledger, R, at, stage.reference)
        return contact, in_grid, beyond
    wrench_of(current, contact, R, stage, other)
    if turn:
        advance(ledger, limits, contact, R, at, stage.reference, other, wrench)
    share = ledger[PROGRESS]
    if share < 1.0:
        for c in range(6):
            wrench[c] = (1.0 - share) * other[c] + share * wrench[c]
    return contact, in_grid, beyond
