"""The haptic renderer: one library call per frame, force and torque of a pose.

The same points, voxels and weights as the rows of the fit (`ttus_opt.contact.rows`),
compiled (`ttus_opt.haptic.wrench`): the wrench of a field as
`ttus_opt.haptic.field_wrench` defines it, drag included, to rounding. A new field comes
in while another thread renders (`Renderer.update`), blended so that it neither jumps
nor adds energy (`ttus_opt.haptic.blend`). Nothing here loads a modelling package, a
solver or a camera.
"""

from __future__ import annotations

import math
import threading
import warnings
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ttus_opt.arrays import Array
from ttus_opt.contact.shell_blocks import ShellBlocks
from ttus_opt.errors import InputError, TtusWarning
from ttus_opt.haptic.blend import (
    PROGRESS,
    BlendLaw,
    BlendState,
    opened_ledger,
    settled_ledger,
)
from ttus_opt.haptic.drag import patch_weights
from ttus_opt.haptic.field_swap import (
    RenderedField,
    RenderedFields,
    require_alike,
    swapped,
)
from ttus_opt.haptic.field_wrench import DragSource
from ttus_opt.haptic.field_wrench import Wrench as Wrench
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.haptic.motion import TIME, MotionFilter
from ttus_opt.haptic.tables import frame_table, render_tables, table_of
from ttus_opt.haptic.wrench import (
    BAD_TIME,
    BAD_TWIST,
    TWIST,
    WRENCH,
    FrameBuffers,
    FrameLimits,
    mixed,
    mixed_drag,
)
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.pose import PoseLike, QuaternionOrder, pose_of, rotations
from ttus_opt.voxmap.doubt_map import DoubtMap
from ttus_opt.voxmap.field import PotentialField

if TYPE_CHECKING:
    from ttus_opt.haptic.c_interface import CFunction, Context


class Renderer:
    """Renders contact of one probe with one field, and with the fields after it.

    One thread renders, a second one at the same time is refused; any other may call
    `update` and `warm_up`. A frame never waits for a lock: while an update prepares a
    swap, frames go on with the present fields. `render_into` allocates nothing;
    `render` allocates the `Wrench` that it returns. Compiled code runs without the
    interpreter's lock, here and in the fit; a thread busy in plain Python holds that
    lock for up to `sys.getswitchinterval`, so give such work a process of its own, or
    run the loop in C (`c_function`).

    A field that was fitted with friction drags on a moving probe. How it moves is
    given as a twist, or estimated from poses with their times (`MotionFilter`); with
    neither, a frame has the contact's wrench without drag, `Wrench.drag` says so, and
    the first such frame warns.

    Args:
        field: The fitted field.
        shell: The probe's point shell.
        blend: How updates come in; `BlendLaw`'s defaults when not given.
        motion: How a twist is estimated; `MotionFilter`'s defaults when not given.
        force_limit: Most force [N]: a larger one is cut to it, direction kept, the
            torque by the same factor. No limit by default.
        doubt: How sure presses are over the skin, of the first field: `render` then
            gives `Wrench.force_std`, looked up and not computed. True takes the map
            that the field has.

    Raises:
        InputError: A limit that is not positive, unusable drag parameters, or a field
            without the map that is asked for.
    """

    def __init__(
        self,
        field: PotentialField,
        shell: PointShell,
        *,
        blend: BlendLaw | None = None,
        motion: MotionFilter | None = None,
        force_limit: float | None = None,
        doubt: DoubtMap | bool | None = None,
    ) -> None:
        self._doubt = _map_of(doubt, field)
        if force_limit is not None and not force_limit > 0.0:
            raise InputError(f"force_limit must be positive [N], got {force_limit}")
        blend, motion = blend or BlendLaw(), motion or MotionFilter()
        self._field = field
        self._data = FrameData.of(
            field.voxmap,
            shell,
            trilinear=field.sampling != "voxel-mean",
            by_size=field.sampling == "contact-size",
        )
        weights = patch_weights(shell)[ShellBlocks.of(shell).order]
        numbers = (
            *blend.kernel_limits(shell.rms_radius),
            math.inf if force_limit is None else float(force_limit),
            *motion.kernel_numbers(shell.rms_radius),
        )
        self._limits = FrameLimits(np.array(numbers), np.ascontiguousarray(weights))
        only = RenderedField.of(field)
        self._fields = RenderedFields.of(only, only, settled_ledger(blend.reserve))
        # a pose is copied here: whatever its layout, it compiles nothing new
        self._buffers = FrameBuffers.empty()
        self._table = frame_table(self._data, self._buffers, self._limits)
        self._turn = threading.Lock()  # of the buffers; a frame only tries it
        self._ledger_lock = threading.Lock()  # to change the ledger; frames only try it
        self._waiting = False  # an update wants the ledger
        self._updates = threading.Lock()  # one update at a time
        self._warned = False  # that drag is left out
        self._c: Context | None = None  # of a loop in C
        self.warm_up()

    def __repr__(self) -> str:
        grid, sampling = self._field.voxmap.grid, self._field.sampling
        return f"<Renderer of {grid.sizes}, {sampling}, drag: {self._fields.drag}>"

    def warm_up(self) -> None:
        """Compile, so that no frame or update has to; called on construction.

        It works on scratch of its own, so that another thread may render meanwhile.
        """
        data, amid = self._data.with_own_scratch(), settled_ledger(0.0)
        amid[PROGRESS] = 0.5
        pair = self._fields.pair._replace(ledger=amid)
        buffers = FrameBuffers.empty()
        table = frame_table(data, buffers, self._limits)
        render_tables(table, table_of(pair), data.trilinear, math.nan, True)
        opened_ledger(amid, pair.current, pair.target, data)
        mixed(pair.current[:4], pair.target[:4], 0.5)
        mixed_drag(amid, pair, pair.current, data, self._limits.weights)

    def render(
        self,
        rotation: PoseLike,
        position: ArrayLike | None = None,
        twist: Array | None = None,
        *,
        time: float | None = None,
        order: QuaternionOrder | None = None,
    ) -> Wrench:
        """Force and torque of one pose and motion.

        Args:
            rotation: Probe to patient: a matrix (3, 3), a SciPy `Rotation`, or a
                quaternion (4,) with its ``order``; or the whole pose as a matrix
                (4, 4). Rounding of up to 1e-5 is corrected (`ttus_opt.probe.pose`).
            position: Of the probe frame's origin, patient frame, shape (3,) [m]; not
                with a whole pose.
            twist: Velocity of that origin and angular velocity, patient axes, shape
                (6,) [m/s, rad/s].
            time: Of the pose [s], where the twist is not known: it is estimated from
                this and the poses before, `ttus_opt.haptic.motion`.
            order: Of a quaternion: ``wxyz``, or ``xyzw`` as in ROS.

        Returns:
            The wrench, the caller's own; zero, and ``in_grid`` False, for a pose
            outside the grid.

        Raises:
            InputError: Another form of pose, NaN, a matrix that is not a rotation,
                both twist and time, a time before the last one, or another thread
                that is rendering.
        """
        self._take_turn()
        try:
            counts, drag = self._render(rotation, position, twist, time, order)
            wrench = self._buffers.rows[WRENCH].copy()
            std = math.nan if self._doubt is None else self._std(self._doubt, wrench)
        finally:
            self._turn.release()
        points, in_grid, beyond, saturated = counts
        force, torque = wrench[:3], wrench[3:]
        return Wrench(force, torque, points, in_grid, beyond, drag, saturated, std)

    def _std(self, doubt: DoubtMap, wrench: Array) -> float:
        """Standard deviation of the frame's force, under the probe's origin [N]."""
        size = math.hypot(*wrench[:3].tolist())
        return doubt.at(*self._buffers.at.tolist()) * size if size else 0.0

    def render_into(
        self,
        rotation: PoseLike,
        position: ArrayLike | None,
        out: Array,
        twist: Array | None = None,
        *,
        time: float | None = None,
        order: QuaternionOrder | None = None,
    ) -> int:
        """The same frame into the caller's array.

        Nothing is allocated when the rotation is an array (3, 3).

        Args:
            rotation: As for `render`.
            position: As for `render`, shape (3,) [m]; None with a whole pose.
            out: Force, then torque, shape (6,) [N, N·m]; written.
            twist: As for `render`, shape (6,) [m/s, rad/s].
            time: As for `render` [s].
            order: As for `render`.

        Returns:
            Points in contact, or -1 when no shell point lies within the grid.

        Raises:
            InputError: As `render`.
        """
        if out.shape != (6,):
            raise InputError(f"out must have shape (6,), got {out.shape}")
        self._take_turn()
        try:
            (contact_points, in_grid, _, _), _ = self._render(
                rotation, position, twist, time, order
            )
            out[:] = self._buffers.rows[WRENCH]
        finally:
            self._turn.release()
        return contact_points if in_grid else -1

    def _take_turn(self) -> None:
        """Take the buffers, or `InputError`: another thread has them."""
        if not self._turn.acquire(blocking=False):
            raise InputError(
                "two threads use one Renderer at once: give each thread its own "
                "Renderer"
            )

    def _render(
        self,
        rotation: PoseLike,
        position: ArrayLike | None,
        twist: Array | None,
        time: float | None,
        order: QuaternionOrder | None,
    ) -> tuple[tuple[int, bool, int, bool], DragSource]:
        """Render one pose and motion onto the buffers; what `render_frame` returns."""
        buffers, source = self._buffers, self._set_motion(twist, time)
        if (
            order is None
            and getattr(rotation, "shape", None) == (3, 3)
            and getattr(position, "shape", None) == (3,)
        ):  # nothing to convert: the way of a haptic loop
            buffers.R[:], buffers.at[:] = rotation, position  # type: ignore[assignment]
        else:
            buffers.R[:], buffers.at[:] = pose_of(rotation, position, order)
        now = math.nan if time is None else float(time)
        if now != now and time is not None:
            raise InputError("time must be finite [s], got NaN")
        may_write = not self._waiting and self._ledger_lock.acquire(blocking=False)
        try:
            fields = self._fields
            drag = fields.drag
            counts = render_tables(
                self._table, fields.table, self._data.trilinear, now, may_write
            )
        finally:
            if may_write:
                self._ledger_lock.release()
        if counts[0] < 0:
            self._refuse(counts[0], time)
        if not drag:
            return counts, "none"
        if source == "left out" and not self._warned:
            self._warn(drag)
        return counts, source

    def _set_motion(self, twist: Array | None, time: float | None) -> DragSource:
        """Take over a given twist; returns where the frame has its motion from."""
        if twist is None:
            self._buffers.rows[TWIST] = 0.0
            return "left out" if time is None else "estimated"
        if time is not None:
            raise InputError(
                "give either twist or time: time is for estimating the twist"
            )
        if np.shape(twist) != (6,):
            raise InputError(
                "a twist is velocity [m/s], then angular velocity [rad/s], (6,), got "
                f"{np.shape(twist)}"
            )
        self._buffers.rows[TWIST] = twist
        return "given"

    def _refuse(self, code: int, time: float | None) -> None:
        """Raise for the code of a refused frame."""
        if code == BAD_TWIST:
            raise InputError("the twist contains NaN or infinite values")
        if code == BAD_TIME:
            raise InputError(
                f"time must be finite and not go back [s], got {time} after "
                f"{self._buffers.motion[TIME]}"
            )
        rotations(self._buffers.R)
        raise InputError("position contains NaN or infinite values [m]")

    def _warn(self, drag: str) -> None:
        """Warn, once, that drag is left out."""
        self._warned = True
        warnings.warn(
            f"the field has drag ({drag}), but the probe's motion is unknown, so "
            "frames are rendered without drag; give render a twist, or the time of "
            "each pose",
            TtusWarning,
            stacklevel=4,
        )

    def update(self, field: PotentialField) -> None:
        """Swap in a new field, also while another thread renders.

        The swap is atomic and its effect gradual: force changes by no more than the
        law's rate, and the change adds no energy (`ttus_opt.haptic.blend`). A swap
        still under way goes over into this one from where it stands. Before the first
        frame nothing has been felt, so that the field is simply taken. Its drag may be
        another.

        Args:
            field: On the same grid and surface and with the same sampling.

        Raises:
            InputError: It is for another grid, surface or sampling, or has unusable
                drag parameters.
        """
        require_alike(self._field, field)
        new, data = RenderedField.of(field), self._data.with_own_scratch()
        with self._updates:
            self._waiting = True
            try:
                with self._ledger_lock:
                    if self._c:
                        self._c.pause()
                    weights = self._limits.weights
                    self._fields = swapped(self._fields, new, data, weights)
                    if self._c:
                        self._c.resume(self._fields.pair)
            finally:
                self._waiting = False

    def c_function(self) -> CFunction:
        """The frame for a loop in C or C++ (`ttus_opt.haptic.c_interface`).

        It renders as `render_into` does, without the interpreter, and follows later
        calls of `update`. One loop at a time: a frame in C and one in Python share
        where a swap of fields stands.

        Returns:
            Addresses of the function and of its context, which live as long as the
            renderer.
        """
        from ttus_opt.haptic.c_interface import CFunction, Context, frame_address

        with self._updates:
            if self._c is None:
                self._c = Context(self._data, self._limits, self._fields.pair)
        return CFunction(frame_address(), self._c.words.ctypes.data, self)

    @property
    def blend(self) -> BlendState:
        """Where the last update's swap stands."""
        return BlendState.of(self._fields.pair.ledger)


def _map_of(doubt: DoubtMap | bool | None, field: PotentialField) -> DoubtMap | None:
    """The map that is meant, or `InputError` where there is none of this body."""
    if doubt is None or doubt is False:
        return None
    if isinstance(doubt, DoubtMap):
        surface = field.voxmap.surface
        if doubt.z[0] < surface.z[0] or doubt.z[-1] > surface.z[-1]:
            raise InputError(
                f"the doubt map has heights from {doubt.z[0]:g} to {doubt.z[-1]:g} m, "
                f"the field's body from {surface.z[0]:g} to {surface.z[-1]:g} m: give "
                "the map of this field"
            )
        return doubt
    if doubt is not True or field.doubt is None:
        raise InputError(
            "doubt=True needs a field with a doubt map: fit with ttus-opt fit --doubt, "
            "or give the map of ttus_opt.fitting.skin_doubt.doubt_map"
        )
    return field.doubt
