"""The passive swap of one field for another under a moving probe.

While a new field replaces an old one, the wrench is w = (1−a) w_old + a w_new with a
growing from 0 to 1, one step per frame. A field in which a probe at pose x stores the
energy U(x) (the work it does when the probe leaves) is passive while it stays as it
is. Changing it under the probe is not: at pose x a step δa changes the stored energy by

    δE = δa · ΔU(x),   ΔU = U_new − U_old,

which the operator gets back as work. Since dU = −w·dx, summing by parts over a motion
gives, for the work done on the probe,

    Σ w·δx = U_old(x_0) − U_a(x_K) + Σ δa ΔU(x):

the blend adds energy exactly when Σ δa ΔU > 0. So every frame takes the largest step
within

- the force rate: δa ‖Δf‖ ≤ rate·δt, and δa ‖Δτ‖/ℓ ≤ rate·δt;
- the energy tank: δa ΔU ≤ tank, which steps with ΔU < 0 fill and steps with ΔU > 0
  empty; it starts with a stated reserve, by default nothing.

A softer field under the probe thus comes in at the force rate; a stiffer one waits
until the tank pays for it, the probe is where the new field is no stiffer, or it
leaves the patient (ΔU = 0: the swap is complete in one frame). That wait is the price
of passivity, not a fault; a reserve shortens it by a stated number of joules.

ΔU is observed, not modelled: at the start it is the integral of Δw along a straight way
out, then it falls by Δw·δx (trapezoid) with the motion, and it is exactly 0 whenever
nothing touches. It is as good as the fields are conservative: trilinear ones are up to
the quadrature of the shell, voxel means are not quite (their jumps have no potential).

Drag belongs to each field's wrench, w = contact + drag, and is swapped with it: by the
same a, within the same rate. It stores nothing, so U, ΔU and w in the ledger above are
of contact alone. Nor can swapping it give energy: every drag has power −k ‖v_t‖² ≤ 0
(`ttus_opt.haptic.drag`), and (1−a) drag_old + a drag_new with 0 ≤ a ≤ 1 is a convex
combination of such, so that the operator's work on the blend is the contact's plus
something never negative. This holds for the twist that drag is given; an estimated one
lags (`ttus_opt.haptic.motion`). A limit on the force, cut afterwards, is outside of
this reckoning: cutting is no potential's force.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.compiled import compiled
from ttus_opt.contact.rows import rotated
from ttus_opt.errors import InputError
from ttus_opt.haptic.frame import touch, wrench_of
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.haptic.motion import turn_between

#: Places in a ledger: share of the new field; ΔU; tank; energy injected so far; 1 when
#: a pose is known; then that pose and Δw there
PROGRESS, GAP, TANK, INJECTED, SEEN = 0, 1, 2, 3, 4
ROTATION, PLACE, DIFFERENCE, LEDGER = 5, 14, 17, 23

#: Step of the way out along which the stored energy is integrated [m]
RETREAT_STEP = 5e-4


@dataclass(frozen=True)
class BlendLaw:
    """How fast, and with how much energy, one field may replace another.

    Attributes:
        force_rate: Most change of force by a change of field [N/s]; torque changes at
            most by this times the shell's rms radius [N·m/s].
        frame_seconds: Time between frames; rendering slower only slows the blend [s].
        reserve: Energy that updates may add in all, beyond what they took out [J].
        capacity: Most energy the tank keeps from softening updates [J].
    """

    force_rate: float = 5.0
    frame_seconds: float = 1e-3
    reserve: float = 0.0
    capacity: float = 0.01

    def __post_init__(self) -> None:
        """Refuse a rate or time that is not positive, and an energy below zero."""
        for name in ("force_rate", "frame_seconds"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"{name} must be positive, got {value}")
        for name in ("reserve", "capacity"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise InputError(f"{name} must not be negative [J], got {value}")

    def kernel_limits(self, length: float) -> Array:
        """Force [N], torque [N·m] per frame and tank [J], for torque arm ℓ [m]."""
        force = self.force_rate * self.frame_seconds
        return np.array([force, force * length, max(self.capacity, self.reserve)])


@dataclass(frozen=True)
class BlendState:
    """Where a swap of fields stands.

    Attributes:
        progress: Share a of the new field, 1 when the swap is complete [–].
        stored_gap: ΔU, what the new field would store more at the last pose [J].
        tank: Energy at hand for stiffening steps [J].
        injected: Σ δa ΔU over all updates so far, never above the reserve [J].
    """

    progress: float
    stored_gap: float
    tank: float
    injected: float

    @classmethod
    def of(cls, ledger: Array) -> BlendState:
        """Read a ledger."""
        return cls(*(float(ledger[k]) for k in (PROGRESS, GAP, TANK, INJECTED)))


def settled_ledger(tank: float) -> Array:
    """The ledger of a renderer with one field and ``tank`` joules, shape (LEDGER,)."""
    ledger = np.zeros(LEDGER)
    ledger[PROGRESS], ledger[TANK] = 1.0, tank
    return ledger


def opened_ledger(
    before: Array, current: Array, target: Array, data: FrameData
) -> Array:
    """The ledger of a new swap, at the pose where the last one stood.

    Args:
        before: The ledger so far, with a pose, shape (LEDGER,).
        current: Field in force, flat, shape (V,).
        target: Field to come, flat, shape (V,).
        data: Probe and surface, with scratch of its own.

    Returns:
        Progress 0, tank and injected energy carried over, ΔU by a straight way out.
    """
    ledger = before.copy()
    ledger[PROGRESS] = 0.0
    open_gap(ledger, current, target, data)
    return ledger


@compiled(error_model="numpy", nogil=True)
def open_gap(ledger: Array, current: Array, target: Array, s: FrameData) -> None:
    """Set ΔU and Δw at the ledger's pose (compiled)."""
    R, at = np.empty((3, 3)), np.empty(3)
    pose_of(ledger, s.reference, R, at)
    out_x, out_y = ledger[PLACE], ledger[PLACE + 1]
    distance = math.sqrt(out_x * out_x + out_y * out_y)
    if distance > 0.0:
        out_x, out_y = out_x / distance, out_y / distance
    else:
        out_x = 1.0
    difference, other = np.zeros(6), np.zeros(6)
    for c in range(6):  # element by element: whole slices take seconds to compile
        ledger[DIFFERENCE + c] = 0.0
    gap, last, step = 0.0, 0.0, 0
    while True:
        contact = touch(R, at, s)[0]
        if contact <= 0:
            break
        wrench_of(target, contact, R, s, difference)
        wrench_of(current, contact, R, s, other)
        for c in range(6):
            difference[c] -= other[c]
        along = difference[0] * out_x + difference[1] * out_y
        if step == 0:
            for c in range(6):
                ledger[DIFFERENCE + c] = difference[c]
        else:
            gap += 0.5 * (last + along) * RETREAT_STEP
        last, step = along, step + 1
        at[0] += out_x * RETREAT_STEP
        at[1] += out_y * RETREAT_STEP
    ledger[GAP] = gap + 0.5 * last * RETREAT_STEP


@compiled(error_model="numpy", nogil=True)
def pose_of(ledger: Array, reference: Array, R: Array, at: Array) -> None:
    """Write the ledger's pose into R, shape (3, 3), and at, shape (3,) (compiled)."""
    for i in range(9):
        R[i // 3, i % 3] = ledger[ROTATION + i]
    x, y, z = rotated(R, reference[0], reference[1], reference[2])
    at[0] = ledger[PLACE] - x
    at[1] = ledger[PLACE + 1] - y
    at[2] = ledger[PLACE + 2] - z


@compiled(error_model="numpy", nogil=True)
def advance(
    ledger: Array,
    limits: Array,
    contact: int,
    motion: tuple[float, float, float, float, float, float],
    current: Array,
    target: Array,
    current_drag: Array,
    target_drag: Array,
) -> None:
    """Account for one frame's motion in the ledger and take the swap's step (compiled).

    Args:
        ledger: Of the swap, shape (LEDGER,); written.
        limits: `BlendLaw.kernel_limits`.
        contact: Points in contact.
        motion: Since the frame before, `follow` [m, rad].
        current: Contact of the old field, shape (6,) [N, N·m].
        target: Contact of the new field, shape (6,) [N, N·m].
        current_drag: Drag of the old field, shape (6,) [N, N·m].
        target_drag: Drag of the new field, shape (6,) [N, N·m].
    """
    work, force, torque = 0.0, 0.0, 0.0
    for c in range(6):
        difference = target[c] - current[c]
        work += 0.5 * (ledger[DIFFERENCE + c] + difference) * motion[c]
        ledger[DIFFERENCE + c] = difference
        change = difference + (target_drag[c] - current_drag[c])
        if c < 3:
            force += change * change
        else:
            torque += change * change
    gap = 0.0 if contact == 0 else ledger[GAP] - work
    force, torque = math.sqrt(force), math.sqrt(torque)
    left = 1.0 - ledger[PROGRESS]
    step = left
    if step * force > limits[0]:
        step = limits[0] / force
    if step * torque > limits[1]:
        step = limits[1] / torque
    if step * gap > ledger[TANK]:
        step = ledger[TANK] / gap
    spent = step * gap
    ledger[GAP] = gap
    ledger[TANK] = min(max(ledger[TANK] - spent, 0.0), limits[2])
    ledger[INJECTED] += spent
    ledger[PROGRESS] = 1.0 if step == left else ledger[PROGRESS] + step


@compiled(error_model="numpy", nogil=True)
def follow(
    ledger: Array, R: Array, at: Array, reference: Array
) -> tuple[float, float, float, float, float, float]:
    """Note a pose; the motion since the last one (compiled).

    Returns:
        Displacement of the reference point [m] and rotation vector [rad], patient
        axes; zero when there was no pose yet.
    """
    x, y, z = rotated(R, reference[0], reference[1], reference[2])
    x, y, z = x + at[0], y + at[1], z + at[2]
    dx = x - ledger[PLACE]
    dy = y - ledger[PLACE + 1]
    dz = z - ledger[PLACE + 2]
    ledger[PLACE], ledger[PLACE + 1], ledger[PLACE + 2] = x, y, z
    ax, ay, az, sine, angle = turn_between(R, ledger, ROTATION)
    for c in range(3):
        ledger[ROTATION + c] = R[0, c]
        ledger[ROTATION + 3 + c] = R[1, c]
        ledger[ROTATION + 6 + c] = R[2, c]
    if ledger[SEEN] == 0.0:
        ledger[SEEN] = 1.0
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    scale = angle / sine if sine > 0.0 else 1.0
    return dx, dy, dz, scale * ax, scale * ay, scale * az
