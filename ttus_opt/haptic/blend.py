"""Passive blending from one field to another under a moving probe.

The wrench is w = (1−a) w_old + a w_new, and a grows from 0 to 1, one step per frame.
With U(x) the energy that a field stores at pose x, a step δa changes the stored energy
by δa ΔU(x), ΔU = U_new − U_old, and the blend generates energy if and only if
Σ δa ΔU > 0 (docs/method/rendering.md, Blending fields passively). Every frame therefore
takes the largest step within

- the force rate: δa ‖Δf‖ ≤ rate·δt, and δa ‖Δτ‖/ℓ ≤ rate·δt;
- the energy tank: δa ΔU ≤ tank. Steps with ΔU < 0 fill the tank, steps with ΔU > 0
  empty it; it starts with a given reserve, by default zero, which may be refilled
  whenever the probe is lifted.

A softer field is thus blended in at the force rate. A stiffer one waits until the tank
holds enough energy, until the probe is where the new field stores no more, or until it
leaves the patient (ΔU = 0: the swap is completed in one frame).

ΔU is tracked: it starts as the integral of Δw along a straight path out of the body,
decreases by Δw·δx (trapezoidal rule) with the motion, and is 0 without contact. It is
exact for conservative fields: trilinear ones are conservative up to the quadrature of
the shell, voxel-mean ones only approximately, because they jump, and those by
contact-size only while the patch keeps its length (docs/method/contact.md, 6.4).

Drag is blended with the same a, within the same rate. It stores no energy that a swap
could raise and only dissipates it, as does a convex combination of two drags, so U, ΔU
and w above are those of contact alone. This holds for the twist that the drag uses; an
estimated twist lags (`ttus_opt.haptic.motion`). A force limit is not part of this
energy balance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ttus_opt.contact.rows import rotated
from ttus_opt.core.arguments import expect_not_negative, expect_positive
from ttus_opt.core.arrays import Array
from ttus_opt.core.compiled import compiled
from ttus_opt.haptic.frame import touch, wrench_of
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.haptic.motion import STILL, Way, set_pose, way_from
from ttus_opt.haptic.presliding import BRISTLE

#: Indices in a ledger: share a of the new field; ΔU; tank; energy injected so far; 1
#: when a pose is known; then that pose, as `motion.set_pose` stores it, Δw there, and a
#: bristle of `ttus_opt.haptic.presliding`
PROGRESS, GAP, TANK, INJECTED, SEEN = 0, 1, 2, 3, 4
PLACE, ROTATION, DIFFERENCE, BENT = 5, 8, 17, 23
LEDGER = BENT + BRISTLE

#: Step of the path out of the body along which the stored energy is integrated [m]
RETREAT_STEP = 5e-4


@dataclass(frozen=True)
class BlendLaw:
    """Limits on the rate and the energy with which one field replaces another.

    Attributes:
        force_rate: Largest rate of change of the force by blending [N/s]; that of the
            torque is this times the shell's rms radius [N·m/s].
        frame_seconds: Time between frames [s]; slower rendering only slows the blend.
        reserve: Energy that all updates together may add beyond what they removed [J].
        capacity: Largest energy that the tank keeps from softening updates [J].
        per_contact: Whether the reserve is that of every single contact: the tank is
            refilled to it when the probe has left the patient. What one contact added,
            the hand has absorbed by then.
    """

    force_rate: float = 5.0
    frame_seconds: float = 1e-3
    reserve: float = 0.0
    capacity: float = 0.01
    per_contact: bool = False

    def __post_init__(self) -> None:
        """Refuse a rate or time that is not positive, and an energy below zero."""
        for name in ("force_rate", "frame_seconds"):
            expect_positive(getattr(self, name), name)
        for name in ("reserve", "capacity"):
            expect_not_negative(getattr(self, name), name, "J")

    def kernel_limits(self, length: float) -> Array:
        """Largest force [N] and torque [N·m] step, tank and refill [J], for ℓ [m]."""
        force = self.force_rate * self.frame_seconds
        most = max(self.capacity, self.reserve)
        refilled = self.reserve if self.per_contact else 0.0
        return np.array([force, force * length, most, refilled])


@dataclass(frozen=True)
class BlendState:
    """State of a swap of fields.

    Attributes:
        progress: Share a of the new field, 1 when the swap is complete [–].
        stored_gap: ΔU, stored energy of the new field minus that of the old one at the
            last pose [J].
        tank: Energy available for stiffening steps [J].
        injected: Σ δa ΔU over all updates so far [J]; never above the reserve, unless
            that is of every contact.
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
    before: Array,
    current: Array,
    target: Array,
    data: FrameData,
    over: FrameData | None = None,
) -> Array:
    """The ledger at the start of a swap.

    Args:
        before: The previous ledger, with a known pose, shape (LEDGER,).
        current: Present field, flat, shape (V,).
        target: New field, flat, shape (V,).
        data: Probe and surface, with its own scratch arrays.
        over: The same with the new field's surface, where that is another.

    Returns:
        Progress 0; pose, tank and injected energy of ``before``; ΔU at that pose.
    """
    ledger = before.copy()
    ledger[PROGRESS] = 0.0
    open_gap(ledger, current, target, data, over or data, over is None)
    return ledger


@compiled(error_model="numpy", nogil=True)
def refill(ledger: Array, limits: Array, lifted: bool) -> None:
    """Refill the tank of a probe that has been lifted (compiled)."""
    if lifted:
        ledger[TANK] = max(ledger[TANK], limits[3])


@compiled(error_model="numpy", nogil=True)
def open_gap(
    ledger: Array,
    current: Array,
    target: Array,
    old: FrameData,
    s: FrameData,
    alike: bool,
) -> None:
    """Set ΔU and Δw at the ledger's pose (compiled).

    Args:
        ledger: Ledger of the swap, shape (LEDGER,); written.
        current: Present field, flat, shape (V,).
        target: New field, flat.
        old: Probe and present surface.
        s: Probe and new surface.
        alike: Whether the surfaces are the same; ``old`` is then not used.
    """
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
        before = contact if alike else touch(R, at, old)[0]
        if max(contact, before) <= 0:
            break
        wrench_of(target, contact, R, s, difference)
        if alike:
            wrench_of(current, contact, R, s, other)
        else:
            wrench_of(current, before, R, old, other)
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
    motion: Way,
    current: Array,
    target: Array,
    current_drag: Array,
    target_drag: Array,
) -> None:
    """Enter one frame's motion into the ledger and take a blending step (compiled).

    Args:
        ledger: Ledger of the swap, shape (LEDGER,); written.
        limits: `BlendLaw.kernel_limits`.
        contact: Number of points in contact.
        motion: Motion since the previous frame, from `follow` [m, rad].
        current: Contact wrench of the old field, shape (6,) [N, N·m].
        target: Contact wrench of the new field, shape (6,) [N, N·m].
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
def follow(ledger: Array, R: Array, at: Array, reference: Array) -> Way:
    """Store a pose in the ledger and return the motion since the last (compiled).

    Returns:
        Displacement of the reference point [m] and rotation vector [rad], patient
        axes; zero for the first pose.
    """
    x, y, z = rotated(R, reference[0], reference[1], reference[2])
    x, y, z = x + at[0], y + at[1], z + at[2]
    way: Way = way_from(ledger, PLACE, R, x, y, z)
    set_pose(ledger, PLACE, R, x, y, z)
    if ledger[SEEN] == 0.0:
        ledger[SEEN] = 1.0
        return STILL
    return way
