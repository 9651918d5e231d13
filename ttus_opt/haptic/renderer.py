"""The haptic renderer: force and torque of a pose, one library call per frame.

It uses the same points, voxels and weights as the rows of the fit
(`ttus_opt.contact.rows`), compiled (`ttus_opt.haptic.wrench`), and computes the wrench
of a field that `ttus_opt.haptic.field_wrench` defines, drag included, up to rounding.
`Renderer.update` replaces the field while another thread renders; the blend has no jump
and adds no energy (`ttus_opt.haptic.blend`). Neither cvxpy nor a solver nor OpenCV is
imported here.
"""

from __future__ import annotations

import functools
import math
import threading
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ttus_opt.contact.shell_blocks import ShellBlocks
from ttus_opt.core.arguments import expect
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError, warn
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
from ttus_opt.haptic.field_wrench import (
    FORCE_LIMIT,
    TORQUE_LIMIT,
    DragSource,
    Limit,
    checked_limits,
)
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
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.uncertainty_map import UncertaintyMap

if TYPE_CHECKING:
    from ttus_opt.haptic.c_interface import CFunction, Context


#: Names of what a frame says limited it
LIMITS: tuple[Limit, ...] = ("", "force", "torque", "end")


class Renderer:
    """Renders the contact of one probe with a field that may be updated.

    One thread renders; a second one at the same time is refused. Any thread may call
    `update` and `warm_up`. A frame never waits for a lock: while an update prepares a
    swap, frames continue with the present fields. `render_into` allocates nothing;
    `render` allocates the `Wrench` that it returns. Compiled code runs without the
    GIL, here and in the fit, but a thread busy in plain Python holds the GIL for up to
    `sys.getswitchinterval`: run such work in another process, or the haptic loop in C
    (`c_function`). A pickled renderer is built anew in the other process, with the
    newest field, settled, and without a motion.

    A field fitted with friction exerts drag on a moving probe. The motion is given as a
    twist or estimated from poses and their times (`MotionFilter`). With neither, frames
    are rendered without drag, `Wrench.drag` says so, and the first such frame warns.

    Args:
        field: The fitted field.
        shell: The probe's point shell.
        blend: How updates are blended in; by default `BlendLaw()`.
        motion: How a twist is estimated; by default `MotionFilter()`.
        force_limit: Largest force [N]: a larger one is scaled down to it, and the
            torque by the same factor. ``math.inf`` for none.
        torque_limit: Largest torque [N·m], alike. A wrench beyond both limits is scaled
            by the smaller factor.
        uncertainty: Relative standard deviation of the force over the skin, for the
            first field; `render` then looks up `Wrench.force_std`. True takes the map
            stored with the field.

    Raises:
        InputError: A limit that is not positive, unusable drag parameters, or
            ``uncertainty=True`` for a field without a map.
    """

    def __init__(
        self,
        field: PotentialField,
        shell: PointShell,
        *,
        blend: BlendLaw | None = None,
        motion: MotionFilter | None = None,
        force_limit: float = FORCE_LIMIT,
        torque_limit: float = TORQUE_LIMIT,
        uncertainty: UncertaintyMap | bool | None = None,
    ) -> None:
        expect(field, PotentialField, "the field")
        expect(shell, PointShell, "the probe")
        self._uncertainty = _map_of(uncertainty, field)
        checked_limits(force_limit, torque_limit)
        blend, motion = blend or BlendLaw(), motion or MotionFilter()
        self._field = self._newest = field
        self._shell = shell
        self._options: dict[str, Any] = {
            "blend": blend,
            "motion": motion,
            "force_limit": force_limit,
            "torque_limit": torque_limit,
        }
        self._data = FrameData.of(field.voxmap, shell, field.sampling)
        weights = patch_weights(shell)[ShellBlocks.of(shell).order]
        numbers = (
            *blend.kernel_limits(shell.rms_radius),
            float(force_limit),
            float(torque_limit),
            *motion.kernel_numbers(shell.rms_radius),
        )
        self._limits = FrameLimits(np.array(numbers), np.ascontiguousarray(weights))
        only = RenderedField.of(field)
        self._fields = RenderedFields.of(only, only, settled_ledger(blend.reserve))
        # poses are copied here, so that no array layout triggers a compilation
        self._buffers = FrameBuffers.empty()
        self._table = frame_table(self._data, self._buffers, self._limits)
        self._turn = threading.Lock()  # guards the buffers; frames never wait for it
        self._ledger_lock = threading.Lock()  # guards the ledger; nor for this one
        self._waiting = False  # an update wants the ledger
        self._updates = threading.Lock()  # one update at a time
        self._warned = False  # that drag is left out
        self._c: Context | None = None  # memory of a loop in C
        self.warm_up()

    def __repr__(self) -> str:
        grid, sampling = self._field.voxmap.grid, self._field.sampling
        return f"<Renderer of {grid.sizes}, {sampling}, drag: {self._fields.drag}>"

    def __reduce__(self) -> tuple[Any, ...]:
        """To another process: built anew with the newest field, at rest."""
        known = {**self._options, "uncertainty": self._uncertainty}
        again = functools.partial(Renderer, **known)
        return again, (self._newest, self._shell)

    def warm_up(self) -> None:
        """Compile everything that frames and updates use; called on construction.

        It works on its own scratch arrays, so another thread may render meanwhile.
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
            position: Origin of the probe frame, patient frame, shape (3,) [m]; omitted
                with a matrix (4, 4).
            twist: Velocity of that origin and angular velocity, patient axes, shape
                (6,) [m/s, rad/s].
            time: Time of the pose [s], if the twist is not known: it is then estimated
                from this and the previous poses, `ttus_opt.haptic.motion`.
            order: Order of a quaternion: ``wxyz``, or ``xyzw`` as in ROS.

        Returns:
            The wrench, in new arrays; zero, with ``in_grid`` False, for a pose outside
            the grid.

        Raises:
            InputError: An unknown form of pose, NaN, a matrix that is not a rotation,
                both twist and time, a time before the last one, or another thread
                rendering at the same time.
        """
        self._take_turn()
        try:
            counts, drag = self._render(rotation, position, twist, time, order)
            wrench = self._buffers.rows[WRENCH].copy()
            std = self._force_std(wrench)
        finally:
            self._turn.release()
        points, in_grid, beyond, limit = counts
        force, torque = wrench[:3], wrench[3:]
        return Wrench(force, torque, points, in_grid, beyond, drag, LIMITS[limit], std)

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
        """Like `render`, but writes into the caller's array.

        Nothing is allocated when the rotation is an array (3, 3).

        Args:
            rotation: As for `render`.
            position: As for `render`, shape (3,) [m]; None with a matrix (4, 4).
            out: Force, then torque, shape (6,) [N, N·m]; written.
            twist: As for `render`, shape (6,) [m/s, rad/s].
            time: As for `render` [s].
            order: As for `render`.

        Returns:
            Points in contact, or -1 when no shell point lies within the grid.

        Raises:
            InputError: As for `render`.
        """
        if out.shape != (6,) or out.dtype.kind != "f":  # whole numbers cut forces
            raise InputError(
                f"out must have floats of shape (6,), got {out.dtype} {out.shape}"
            )
        self._take_turn()
        try:
            (contact_points, in_grid, _, _), _ = self._render(
                rotation, position, twist, time, order
            )
            out[:] = self._buffers.rows[WRENCH]
        finally:
            self._turn.release()
        return contact_points if in_grid else -1

    def _force_std(self, wrench: Array) -> float:
        """Standard deviation of the frame's force; NaN if unknown [N]."""
        if self._uncertainty is None:
            return math.nan
        size = math.hypot(*wrench[:3].tolist())
        at = self._buffers.at.tolist()
        return self._uncertainty.at(*at) * size if size else 0.0

    def _take_turn(self) -> None:
        """Lock the buffers; `InputError` if another thread has them."""
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
    ) -> tuple[tuple[int, bool, int, int], DragSource]:
        """Render into the buffers; what `render_frame` returns, and the drag."""
        buffers, source = self._buffers, self._set_motion(twist, time)
        if (
            order is None
            and getattr(rotation, "shape", None) == (3, 3)
            and getattr(position, "shape", None) == (3,)
        ):  # nothing to convert: the fast path of a haptic loop
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
        if source == "left out" and fields.held_by_poses:
            return counts, "estimated"
        if source == "left out" and not self._warned:
            self._warn(drag)
        return counts, source

    def _set_motion(self, twist: Array | None, time: float | None) -> DragSource:
        """Store a given twist; returns the source of the frame's motion."""
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
        """Raise the error of a refused frame."""
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
        warn(
            f"the field has drag ({drag}), but the probe's motion is unknown, so "
            "frames are rendered without drag; give render a twist, or the time of "
            "each pose",
            3,
        )

    def update(self, field: PotentialField) -> None:
        """Replace the field, possibly while another thread renders.

        The swap is atomic and its effect gradual: the force changes at most at the
        rate of the `BlendLaw`, and the change adds no energy (`ttus_opt.haptic.blend`).
        A swap that is still under way is continued from its present state. Before the
        first frame the new field is used at once. Its drag may differ.

        Args:
            field: Has the same grid, surface and sampling.

        Raises:
            InputError: Another grid, surface or sampling, or unusable drag parameters.
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
                    self._newest = field
                    if self._c:
                        self._c.resume(self._fields.pair)
            finally:
                self._waiting = False

    def present(self) -> tuple[Array, FrameData]:
        """The field as it is felt now, flat (V,), and the surface, with own scratch."""
        pair = self._fields.pair
        share = float(pair.ledger[PROGRESS])
        values = mixed(pair.current, pair.target, share)
        return values, self._data.with_own_scratch()

    def take_motion(self, other: Renderer) -> None:
        """Continue another renderer's estimate of the probe's motion."""
        self._buffers.motion[:] = other._buffers.motion

    def c_function(self) -> CFunction:
        """The haptic frame as a C function (`ttus_opt.haptic.c_interface`).

        It computes what `render_into` computes, without the interpreter, and follows
        later calls of `update`. Run only one loop at a time: frames in C and in Python
        share the state of a swap.

        Returns:
            Addresses of the function and of its context, valid as long as the renderer
            lives.
        """
        from ttus_opt.haptic.c_interface import CFunction, Context, frame_address

        with self._updates:
            if self._c is None:
                self._c = Context(self._data, self._limits, self._fields.pair)
        return CFunction(frame_address(), self._c.words.ctypes.data, self)

    @property
    def blend(self) -> BlendState:
        """State of the last update's swap."""
        return BlendState.of(self._fields.pair.ledger)


def _map_of(
    given: UncertaintyMap | bool | None, field: PotentialField
) -> UncertaintyMap | None:
    """The map of uncertainty to use: the one given, or with True the field's own.

    Raises:
        InputError: The map is missing, or of another body.
    """
    if given is None or given is False:
        return None
    if given is True and field.uncertainty is not None:
        return field.uncertainty
    if not isinstance(given, UncertaintyMap):
        raise InputError(
            "uncertainty=True needs a field with an uncertainty map: fit with "
            "ttus-opt fit --uncertainty, or give the map of "
            "fitting.uncertainty.skin_uncertainty.uncertainty_map"
        )
    surface = field.voxmap.surface
    if given.z[0] < surface.z[0] or given.z[-1] > surface.z[-1]:
        raise InputError(
            f"the uncertainty map has heights from {given.z[0]:g} to "
            f"{given.z[-1]:g} m, the field's body from {surface.z[0]:g} to "
            f"{surface.z[-1]:g} m: give the map of this field"
        )
    return given
