"""Friction of a probe that does not slide yet: a bristle of bounded deflection.

Coulomb drag needs a direction of sliding, which a hand that holds still has not. With a
presliding length ℓ > 0 it becomes Dahl's model with exponent 0 (a Prandtl stop): the
deflection b, tangential and of length at most 1, follows the displacement δs of the
probe where drag acts, found from successive poses,

    b ← (b + δs/ℓ) / max(1, ‖b + δs/ℓ‖),   f_d = −M b,   M = μ max(n̂ᵀf, 0).

It holds its drag when the hand stops, and is Coulomb's once a slide is reversed by 2ℓ.
Its energy E = M ℓ ‖b‖²/2 never rises by more than the work −f_dᵀδs that the hand does:
the step of b is a projection onto a ball; where M rises, b shrinks so that the force
stays; where M falls or the contact turns, E falls. Without contact b is zero.

Where drag acts at every point, a probe that is pressed straight in slides along its
flanks, and its press is heavier than its release: a deflection b_n along n̂ adds
−M_n b_n n̂, with the drag M_n of all points when the probe moves along n̂ (`flank_of`).
Its length is ℓ_n = ℓ M_n/M: skin shears as stiffly along n̂ as across. It is at most 1,
and a slide takes the other's place: over a share of ℓ across it takes that share of
b_n, along n̂ of b. What shrinks loses energy, so that E_n = M_n ℓ_n b_n²/2 is bounded as
E is.

References: P. R. Dahl, A solid friction model, Aerospace Corporation TOR-0158, 1968;
V. Hayward, B. Armstrong, A new computational model of friction applied to haptic
rendering, 2000.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ttus_opt.contact.friction import Sliding
from ttus_opt.contact.rows import rotated
from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.compiled import compiled
from ttus_opt.haptic.drag import (
    ACTS_AT,
    AT_POINTS,
    AT_REFERENCE,
    AXIS,
    FRICTION,
    PRESLIDING,
)
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.haptic.motion import Way, ways_along
from ttus_opt.haptic.point_drag import add_point_drag
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory

#: Entries of a bristle: b [–], then the M [N] and ℓ [m] it was last bent at, b_n [–],
#: and the M_n it was last bent at [N]
STRENGTH, LENGTH, ALONG, FLANK, BRISTLE = 3, 4, 5, 6, 7


@compiled(inline="always")
def strength_of(patch: Array, wrench: Array, numbers: Array) -> float:
    """M of a field with presliding, 0 without [N] (compiled)."""
    if numbers[PRESLIDING] == 0.0:
        return 0.0
    pressed = patch[0] * wrench[0] + patch[1] * wrench[1] + patch[2] * wrench[2]
    return numbers[FRICTION] * max(pressed, 0.0)  # type: ignore[no-any-return]


@compiled(error_model="numpy", nogil=True)
def flank_of(
    R: Array, patch: Array, contact: int, s: FrameData, numbers: Array, rows: Array
) -> float:
    """M_n of the field sampled last, 0 unless drag is at its points [N] (compiled).

    Args:
        R: Rotation, probe to patient, shape (3, 3) [–].
        patch: `drag.patch_of`, shape (6,).
        contact: What `frame.touch` returned.
        s: Probe, surface and scratch.
        numbers: `DragLaw.numbers` of the field.
        rows: Scratch, shape (2, 6).
    """
    if numbers[PRESLIDING] == 0.0 or numbers[ACTS_AT] != AT_POINTS:
        return 0.0
    twist, drag = rows[0], rows[1]
    for c in range(6):
        twist[c], drag[c] = patch[c] if c < 3 else 0.0, 0.0
    add_point_drag(R, twist, contact, s, numbers, drag)
    against: float = patch[0] * drag[0] + patch[1] * drag[1] + patch[2] * drag[2]
    return max(-against, 0.0)


@compiled(error_model="numpy", nogil=True)
def bend(
    bristle: Array,
    way: Way,
    R: Array,
    patch: Array,
    strength: float,
    flank: float,
    numbers: Array,
) -> None:
    """Let a bristle follow one frame's motion (compiled).

    Args:
        bristle: By the indices above, shape (BRISTLE,), zeros at first; written.
        way: Displacement of the reference and rotation vector, patient axes [m, rad].
        R: Rotation, probe to patient, shape (3, 3) [–].
        patch: `drag.patch_of`, shape (6,).
        strength: M of this frame [N].
        flank: M_n of this frame [N].
        numbers: `DragLaw.numbers` of the field.
    """
    held, before, length = bristle[STRENGTH], bristle[LENGTH], numbers[PRESLIDING]
    held_along = bristle[FLANK]
    bristle[STRENGTH], bristle[LENGTH], bristle[FLANK] = strength, length, flank
    if strength == 0.0 or held == 0.0:  # a contact begins with a straight bristle
        bristle[0], bristle[1], bristle[2], bristle[ALONG] = 0.0, 0.0, 0.0, 0.0
        return
    ax, ay, az, ex, ey, ez = patch[3], patch[4], patch[5], patch[0], patch[1], patch[2]
    if numbers[ACTS_AT] == AT_REFERENCE:
        ax, ay, az = 0.0, 0.0, 0.0
        ex, ey, ez = rotated(R, numbers[AXIS], numbers[AXIS + 1], numbers[AXIS + 2])
    stays = min(math.sqrt(before / length), 1.0)
    keep = min(held / strength, 1.0) * stays
    sx = (way[0] + way[4] * az - way[5] * ay) / length
    sy = (way[1] + way[5] * ax - way[3] * az) / length
    sz = (way[2] + way[3] * ay - way[4] * ax) / length
    bn = slid = 0.0  # b_n, and how far it slides, in units of ℓ
    if flank > 0.0:
        softens = min(math.sqrt(before * strength / (length * held)), 1.0)
        bn = min(held_along / flank, 1.0) * softens * bristle[ALONG]
        bn += (ex * sx + ey * sy + ez * sz) * strength / flank
        beyond = max(abs(bn), 1.0)
        bn, slid = bn / beyond, (beyond - 1.0) * flank / strength
    bx, by, bz = keep * bristle[0] + sx, keep * bristle[1] + sy, keep * bristle[2] + sz
    along = ex * bx + ey * by + ez * bz
    bx, by, bz = bx - along * ex, by - along * ey, bz - along * ez
    size = max(math.sqrt(bx * bx + by * by + bz * bz), 1.0)
    stays = max(1.0 - slid, 0.0) / size
    bristle[0], bristle[1], bristle[2] = stays * bx, stays * by, stays * bz
    bristle[ALONG] = max(2.0 - size, 0.0) * bn


@compiled(error_model="numpy", nogil=True)
def add_presliding(
    bristle: Array,
    patch: Array,
    wrench: Array,
    flank: float,
    numbers: Array,
    drag: Array,
) -> None:
    """Add the drag of a bent bristle; none for a field without presliding (compiled).

    Args:
        bristle: As `bend` left it.
        patch: `drag.patch_of`, shape (6,).
        wrench: Contact wrench of the field, shape (6,) [N, N·m].
        flank: Its M_n [N].
        numbers: `DragLaw.numbers` of the field.
        drag: Force and torque about the reference, shape (6,) [N, N·m]; added to.
    """
    strength = strength_of(patch, wrench, numbers)
    ax, ay, az = patch[3], patch[4], patch[5]
    if numbers[ACTS_AT] == AT_REFERENCE:
        ax, ay, az = 0.0, 0.0, 0.0
    along = flank * bristle[ALONG]
    fx = -strength * bristle[0] - along * patch[0]
    fy = -strength * bristle[1] - along * patch[1]
    fz = -strength * bristle[2] - along * patch[2]
    drag[0], drag[1], drag[2] = drag[0] + fx, drag[1] + fy, drag[2] + fz
    drag[3] += ay * fz - az * fy
    drag[4] += az * fx - ax * fz
    drag[5] += ax * fy - ay * fx


def with_bristle(
    sliding: Sliding,
    numbers: Array,
    shell: PointShell,
    trajectory: Trajectory,
    force: Array,
) -> Sliding:
    """Sliding with b for its direction; the same for a law without presliding.

    In the rows of a fit b takes the place of the direction of sliding t̂: both depend on
    the motion alone, b also on the ratio of successive normal forces.

    Args:
        sliding: Patches of the poses.
        numbers: `DragLaw.numbers`.
        shell: The probe.
        trajectory: The poses.
        force: Of the contact without drag, in any unit, shape (T, 3).
    """
    if numbers[PRESLIDING] == 0.0:
        return sliding
    pressed = np.einsum("ti,ti->t", sliding.normal, force)
    patch = np.concatenate([sliding.normal, sliding.arm], axis=1)
    R = np.ascontiguousarray(trajectory.rotation)
    ways = np.concatenate([np.zeros((1, 6)), ways_along(shell, trajectory)])
    begins = np.concatenate([[True], np.diff(trajectory.segment) != 0])
    strength = np.maximum(pressed, 0.0)
    return replace(sliding, bristle=_bent(begins, ways, R, patch, strength, numbers))


@compiled(error_model="numpy")
def _bent(
    begins: Mask, ways: Array, rotation: Array, patch: Array, strength: Array,
    numbers: Array,
) -> Array:  # fmt: skip
    """B in every frame of recordings, which begin straight, shape (T, 3) (compiled).

    Args:
        begins: Whether a recording begins, shape (T,).
        ways: From the frame before, shape (T, 6) [m, rad].
        rotation: Probe to patient, shape (T, 3, 3) [–].
        patch: n̂ [–] and c [m], patient axes, shape (T, 6).
        strength: M, shape (T,) [N].
        numbers: `DragLaw.numbers`.
    """
    out, bristle = np.empty((len(begins), 3)), np.zeros(BRISTLE)
    for t in range(len(begins)):
        if begins[t]:
            bristle[:] = 0.0
        a = ways[t]
        way = (a[0], a[1], a[2], a[3], a[4], a[5])
        bend(bristle, way, rotation[t], patch[t], strength[t], 0.0, numbers)
        out[t] = bristle[:3]
    return out
