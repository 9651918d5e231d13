"""One compiled haptic frame: motion, contact, fields, drag, blend, limits.

It runs the passes of `ttus_opt.haptic.frame`, `drag`, `motion` and `blend` over scratch
arrays of the renderer: a frame is one call and allocates nothing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.compiled import compiled
from ttus_opt.haptic.blend import BENT, PROGRESS, advance, follow, pose_of, refill
from ttus_opt.haptic.drag import (
    ACTIVE,
    ACTS_AT,
    AT_POINTS,
    BANDS,
    BY_PATCH,
    FRICTION,
    PRESLIDING,
    SECTORS,
    VISCOUS,
    drag_of,
    patch_of,
)
from ttus_opt.haptic.frame import near_end, touch, wrench_of
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.haptic.motion import MOTION, STILL, Way, estimate_twist
from ttus_opt.haptic.point_drag import add_point_drag
from ttus_opt.haptic.presliding import add_presliding, bend, flank_of, strength_of
from ttus_opt.probe.pose import EXACT, ROUNDING

#: Steps of the Newton-Schulz iteration for the polar factor, R ← R (3I − RᵀR)/2, which
#: squares the error: 1e-5 → 1e-10 → below `EXACT` (Björck & Bowie, An iterative
#: algorithm for computing the best estimate of an orthogonal matrix, SIAM J. Numer.
#: Anal. 8, 1971)
STEPS = 2

#: Returned by a frame instead of a count if its input is unusable
BAD_POSE, BAD_TWIST, BAD_TIME = -1, -2, -3


class FieldPair(NamedTuple):
    """Two fields and the ledger of the swap between them, replaced together.

    Attributes:
        current: Present field, flat, shape (V,).
        target: New field, or the same one, flat, shape (V,).
        current_drag: `DragLaw.numbers` of the present field.
        target_drag: `DragLaw.numbers` of the new field.
        ledger: Ledger of `ttus_opt.haptic.blend`, shape (LEDGER,).
    """

    current: Array
    target: Array
    current_drag: Array
    target_drag: Array
    ledger: Array


#: Rows of `FrameBuffers.rows`: wrench and drag of the frame, twist, patch, then contact
#: wrench and drag of the present field during a swap; M_n of `presliding` of the new
#: and of the present field; two rows of scratch
WRENCH, DRAG, TWIST, PATCH, OLD, OLD_DRAG = 0, 1, 2, 3, 4, 5
FLANKS, SCRATCH, ROWS = 6, 7, 9


class FrameBuffers(NamedTuple):
    """Input, state and output of a frame, for one thread.

    Attributes:
        R: Rotation, probe to patient, shape (3, 3) [–].
        at: Position of the probe frame's origin, shape (3,) [m].
        motion: State of `ttus_opt.haptic.motion`, shape (MOTION,).
        rows: By the indices above, shape (ROWS, 6).
    """

    R: Array
    at: Array
    motion: Array
    rows: Array

    @classmethod
    def empty(cls) -> FrameBuffers:
        """Buffers before the first frame."""
        return cls(np.eye(3), np.zeros(3), np.zeros(MOTION), np.zeros((ROWS, 6)))


#: Indices in `FrameLimits.numbers`: `BlendLaw.kernel_limits`, largest force [N] and
#: torque [N·m], `MotionFilter.kernel_numbers`
BLEND, FORCE, TORQUE, FILTER = 0, 4, 5, 6

#: What limited a wrench; names are in `ttus_opt.haptic.field_wrench.Limit`
UNLIMITED, BY_FORCE, BY_TORQUE, BY_END = 0, 1, 2, 3


class FrameLimits(NamedTuple):
    """The limits and weights of a renderer, the same in every frame.

    Attributes:
        numbers: By the indices above, shape (10,).
        weights: `drag.patch_weights` in block order, shape (M, 7).
    """

    numbers: Array
    weights: Array


@compiled(error_model="numpy", nogil=True)
def render_frame(
    buffers: FrameBuffers,
    time: float,
    data: FrameData,
    pair: FieldPair,
    limits: FrameLimits,
    may_write: bool,
) -> tuple[int, bool, int, int]:
    """Render the pose and twist in the buffers (compiled).

    Args:
        buffers: Input, scratch and output.
        time: Time of the pose, to estimate the twist [s]; NaN to use the given twist.
        data: Probe, surface and scratch.
        pair: Fields and ledger.
        limits: Limits of the renderer.
        may_write: Whether the ledger may be written; otherwise it is only read.

    Returns:
        Number of points in contact, or `BAD_POSE`, `BAD_TWIST`, `BAD_TIME`; whether any
        shell point is in the grid; number of points beyond the inner layer;
        `UNLIMITED`, `BY_FORCE`, `BY_TORQUE` or, without these, `BY_END`.
    """
    R, at, rows, numbers = buffers.R, buffers.at, buffers.rows, limits.numbers
    twist, patch, wrench, drag = rows[TWIST], rows[PATCH], rows[WRENCH], rows[DRAG]
    ledger, reference = pair.ledger, data.reference
    if not (orthonormalise(R) and math.isfinite(at[0] + at[1] + at[2])):
        return BAD_POSE, False, 0, UNLIMITED
    if not math.isnan(time) and not estimate_twist(
        buffers.motion, R, at, time, reference, numbers[FILTER:], twist
    ):
        return BAD_TIME, False, 0, UNLIMITED
    if not math.isfinite(_sum(twist)):
        return BAD_TWIST, False, 0, UNLIMITED
    contact, in_grid, beyond = touch(R, at, data)
    refill(ledger, numbers[BLEND:FORCE], may_write and contact == 0)
    wrench_of(pair.target, contact, R, data, wrench)
    moves, holds = _may_drag(pair, twist), _may_hold(pair)
    if (moves or holds) and max(
        pair.target_drag[ACTIVE], pair.current_drag[ACTIVE]
    ) == BY_PATCH:
        patch_of(R, contact, data.touched, data.depth, limits.weights, patch)
    else:
        _clear(patch)
    _drag(buffers, moves, contact, data, pair.target_drag, WRENCH, DRAG)
    motion = follow(ledger, R, at, reference) if may_write else STILL
    swaps = ledger[PROGRESS] < 1.0
    if swaps:
        wrench_of(pair.current, contact, R, data, rows[OLD])
        _drag(buffers, moves, contact, data, pair.current_drag, OLD, OLD_DRAG)
    if holds:
        _hold(buffers, pair, swaps, may_write, motion)
    if swaps:
        old, old_drag = rows[OLD], rows[OLD_DRAG]
        limit = numbers[BLEND:FORCE]
        if may_write:
            advance(ledger, limit, contact, motion, old, wrench, old_drag, drag)
        _mix(ledger[PROGRESS], old, wrench)
        _mix(ledger[PROGRESS], old_drag, drag)
    for c in range(6):
        wrench[c] += drag[c]
    by = _cut(wrench, numbers[FORCE], numbers[TORQUE])
    ends = by == UNLIMITED and near_end(contact, data)
    return contact, in_grid, beyond, BY_END if ends else by


@compiled(inline="always")
def _drag(
    buffers: FrameBuffers,
    moves: bool,
    contact: int,
    data: FrameData,
    numbers: Array,
    of: int,
    into: int,
) -> None:
    """Drag of the last sampled field, whose wrench is row ``of`` (compiled)."""
    R, rows = buffers.R, buffers.rows
    twist, reference, drag = rows[TWIST], data.reference, rows[into]
    drag_of(R, buffers.at, twist, reference, rows[PATCH], rows[of], numbers, drag)
    scratch, field = rows[SCRATCH:ROWS], 0 if into == DRAG else 1
    rows[FLANKS, field] = flank_of(R, rows[PATCH], contact, data, numbers, scratch)
    at_points = numbers[ACTS_AT] == AT_POINTS and numbers[PRESLIDING] == 0.0
    if moves and at_points and numbers[FRICTION] > 0.0:
        add_point_drag(R, twist, contact, data, numbers, drag)


@compiled(error_model="numpy")
def _hold(
    buffers: FrameBuffers,
    pair: FieldPair,
    swaps: bool,
    may_write: bool,
    motion: Way,
) -> None:
    """Bend the bristle and add its drag to that of the fields (compiled).

    During a swap both fields share it: M is that of their mixture, so that a swap
    leaves the force where it would raise the bristle's energy.
    """
    rows, bristle = buffers.rows, pair.ledger[BENT:]
    patch, new, old = rows[PATCH], pair.target_drag, pair.current_drag
    strength, law = strength_of(patch, rows[WRENCH], new), new
    fresh, before = rows[FLANKS, 0], rows[FLANKS, 1]
    flank = fresh
    if swaps:
        share = pair.ledger[PROGRESS]
        other = strength_of(patch, rows[OLD], old)
        strength = share * strength + (1.0 - share) * other
        flank = share * fresh + (1.0 - share) * before
        law = new if new[PRESLIDING] > 0.0 else old
    if may_write:
        bend(bristle, motion, buffers.R, patch, strength, flank, law)
    add_presliding(bristle, patch, rows[WRENCH], fresh, new, rows[DRAG])
    if swaps:
        add_presliding(bristle, patch, rows[OLD], before, old, rows[OLD_DRAG])


@compiled(inline="always")
def _mix(share: float, old: Array, new: Array) -> None:
    """New ← (1 − share) old + share new; unchanged for a share of 1 (compiled)."""
    if share < 1.0:
        for c in range(6):
            new[c] = (1.0 - share) * old[c] + share * new[c]


@compiled(inline="always")
def _sum(values: Array) -> float:
    """Sum of values; not finite if one of them is not (compiled)."""
    total = 0.0
    for i in range(values.size):
        total += values[i]
    return total


@compiled(inline="always")
def _clear(values: Array) -> None:
    """Set to zero (compiled)."""
    for i in range(values.size):
        values[i] = 0.0


@compiled(inline="always")
def _may_hold(pair: FieldPair) -> bool:
    """Whether a field has friction before sliding (compiled)."""
    return bool(pair.target_drag[PRESLIDING] + pair.current_drag[PRESLIDING] > 0.0)


@compiled(inline="always")
def _may_drag(pair: FieldPair, twist: Array) -> bool:
    """Whether the probe moves and a field has drag (compiled)."""
    if pair.target_drag[ACTIVE] + pair.current_drag[ACTIVE] == 0.0:
        return False
    moves = False
    for i in range(6):
        moves = moves or twist[i] != 0.0
    return moves


@compiled(inline="always")
def _cut(wrench: Array, force: float, torque: float) -> int:
    """Scale a wrench down to the limits; which of them acted (compiled)."""
    ff = wrench[0] * wrench[0] + wrench[1] * wrench[1] + wrench[2] * wrench[2]
    tt = wrench[3] * wrench[3] + wrench[4] * wrench[4] + wrench[5] * wrench[5]
    if ff <= force * force and tt <= torque * torque:
        return UNLIMITED
    by_force, by_torque = math.sqrt(ff) / force, math.sqrt(tt) / torque
    excess = max(by_force, by_torque)
    usable = by_force + by_torque < math.inf  # not so when a sum has overflown
    for c in range(6):
        wrench[c] = wrench[c] / excess if usable else 0.0
    return BY_TORQUE if usable and by_torque > by_force else BY_FORCE


@compiled()
def orthonormalise(R: Array) -> bool:
    """Correct a rotation's rounding in place, as `probe.pose.rotations` (compiled).

    Returns:
        False if it is not a rotation: scaled, sheared, reflected, not finite.
    """
    for _ in range(STEPS + 1):
        xx = R[0, 0] * R[0, 0] + R[1, 0] * R[1, 0] + R[2, 0] * R[2, 0] - 1.0
        yy = R[0, 1] * R[0, 1] + R[1, 1] * R[1, 1] + R[2, 1] * R[2, 1] - 1.0
        zz = R[0, 2] * R[0, 2] + R[1, 2] * R[1, 2] + R[2, 2] * R[2, 2] - 1.0
        xy = R[0, 0] * R[0, 1] + R[1, 0] * R[1, 1] + R[2, 0] * R[2, 1]
        xz = R[0, 0] * R[0, 2] + R[1, 0] * R[1, 2] + R[2, 0] * R[2, 2]
        yz = R[0, 1] * R[0, 2] + R[1, 1] * R[1, 2] + R[2, 1] * R[2, 2]
        # NaN may pass this test, but not the one on the volume
        error = max(abs(xx), abs(yy), abs(zz), abs(xy), abs(xz), abs(yz))
        if error <= EXACT:
            break
        if not error <= ROUNDING:
            return False
        for c in range(3):
            x, y, z = R[c, 0], R[c, 1], R[c, 2]
            R[c, 0] = x - 0.5 * (x * xx + y * xy + z * xz)
            R[c, 1] = y - 0.5 * (x * xy + y * yy + z * yz)
            R[c, 2] = z - 0.5 * (x * xz + y * yz + z * zz)
    volume = (
        R[0, 0] * (R[1, 1] * R[2, 2] - R[1, 2] * R[2, 1])
        + R[0, 1] * (R[1, 2] * R[2, 0] - R[1, 0] * R[2, 2])
        + R[0, 2] * (R[1, 0] * R[2, 1] - R[1, 1] * R[2, 0])
    )
    return bool(volume > 0.0)


@compiled(nogil=True)
def mixed(current: Array, target: Array, share: float) -> Array:
    """(1 − share) current + share target, without the GIL (compiled)."""
    out = np.empty_like(current)
    for m in range(out.size):
        out[m] = (1.0 - share) * current[m] + share * target[m]
    return out


def mixed_drag(
    ledger: Array, pair: FieldPair, mix: Array, data: FrameData, weights: Array
) -> Array:
    """The drag of a mixture of two fields, for an update during a swap.

    At the ledger's pose its μ gives the force of both laws together, so that the force
    does not jump (with drag at every point only as far as both fields agree over the
    patch). Viscous coefficients are averaged by their shares. Deadband, presliding,
    regions and point of action are those of the field with drag, of two the one with
    the larger share; where those of the other field differ, the drag jumps accordingly.

    Args:
        ledger: Has the pose and the share of the target.
        pair: The two fields.
        mix: Their mixture, flat, shape (V,).
        data: Probe and surface, with its own scratch arrays.
        weights: `drag.patch_weights` in block order, shape (M, 7).

    Returns:
        `DragLaw.numbers` of the mixture.
    """
    share = float(ledger[PROGRESS])
    old, new = pair.current_drag, pair.target_drag
    if old[ACTIVE] + new[ACTIVE] == 0.0:
        return new
    major = new if old[ACTIVE] == 0.0 or (share >= 0.5 and new[ACTIVE] > 0.0) else old
    buffers = FrameBuffers.empty()
    pose_of(ledger, data.reference, buffers.R, buffers.at)
    contact = touch(buffers.R, buffers.at, data)[0]
    patch_of(buffers.R, contact, data.touched, data.depth, weights, buffers.rows[PATCH])
    pressed = []
    for values in (pair.current, pair.target, mix):
        wrench_of(values, contact, buffers.R, data, buffers.rows[WRENCH])
        pressed.append(
            max(float(buffers.rows[PATCH, :3] @ buffers.rows[WRENCH, :3]), 0.0)
        )
    frictions = float(old[FRICTION]), float(new[FRICTION])
    friction = (1.0 - share) * frictions[0] + share * frictions[1]
    if pressed[2] > 0.0:
        friction = (
            (1.0 - share) * frictions[0] * pressed[0]
            + share * frictions[1] * pressed[1]
        ) / pressed[2]
    numbers = major.copy()
    numbers[ACTIVE] = max(old[ACTIVE], new[ACTIVE])
    numbers[FRICTION] = min(friction, max(frictions))
    if (old[SECTORS : BANDS + 1] == new[SECTORS : BANDS + 1]).all():
        numbers[VISCOUS:] = (1.0 - share) * old[VISCOUS:] + share * new[VISCOUS:]
    return numbers
