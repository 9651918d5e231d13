"""The bristle of `ttus_opt.haptic.presliding` along a whole recording.

In the rows of a fit its deflection b takes the place of the direction of sliding t̂:
both depend on the motion alone, b also on the ratio of successive normal forces.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttus_opt.contact.friction import Sliding
from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.compiled import compiled
from ttus_opt.haptic.blend import follow, settled_ledger
from ttus_opt.haptic.drag import PRESLIDING
from ttus_opt.haptic.presliding import BRISTLE, bend
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory


def with_bristle(
    sliding: Sliding,
    numbers: Array,
    shell: PointShell,
    trajectory: Trajectory,
    force: Array,
) -> Sliding:
    """Sliding with b for its direction; the same for a law without presliding.

    Args:
        sliding: Patches of the poses.
        numbers: `DragLaw.numbers`.
        shell: The probe.
        trajectory: The poses; a recording begins with a straight bristle.
        force: Of the contact without drag, in any unit, shape (T, 3).
    """
    if numbers[PRESLIDING] == 0.0:
        return sliding
    pressed = np.einsum("ti,ti->t", sliding.normal, force)
    bristle = _path(
        np.concatenate([[True], np.diff(trajectory.segment) != 0]),
        np.ascontiguousarray(trajectory.rotation),
        np.ascontiguousarray(trajectory.position),
        np.array(shell.reference),
        np.concatenate([sliding.normal, sliding.arm], axis=1),
        np.maximum(pressed, 0.0),
        numbers,
        settled_ledger(0.0),
    )
    return replace(sliding, bristle=bristle)


@compiled(error_model="numpy")
def _path(
    begins: Mask,
    rotation: Array,
    position: Array,
    reference: Array,
    patch: Array,
    strength: Array,
    numbers: Array,
    ledger: Array,
) -> Array:
    """Deflection b of every frame, shape (T, 3) (compiled)."""
    deflection, bristle = np.zeros((len(begins), 3)), np.zeros(BRISTLE)
    at_first = ledger.copy()
    for t in range(len(begins)):
        if begins[t]:
            ledger[:] = at_first
            bristle[:] = 0.0
        R = rotation[t]
        way = follow(ledger, R, position[t], reference)
        bend(bristle, way, R, patch[t], strength[t], 0.0, numbers)
        for c in range(3):
            deflection[t, c] = bristle[c]
    return deflection
