"""How much of a recording's drag no elastic force explains.

Contact without friction pushes along its own normal force, in proportion to a law of
force over depth that is never known exactly. Drag along that force looks like a part of
this law unless it reverses: while a probe is pressed straight in, drag along its flanks
only adds to the force, while it is released it only subtracts. Drag across the force
cannot come from an elastic contact at all.

With g the drag of every frame per unit μ, split along and across the elastic force, and
for a place k (`ttus_opt.contact.places`) A the sum of squares of the part across, P and
Q those of the part along in frames where it adds and where it subtracts, the share of
‖g‖² that remains when drag of constant sense is projected out of every place is

    ρ = Σ_k (A_k + 4 P_k Q_k/(P_k + Q_k)) / Σ_k (A_k + P_k + Q_k).

Least squares weighs both parts by their squares: μ̂ = ρ μ̂_distinct + (1 - ρ) μ̂_elastic,
and the second one is the error of the law of force, in units of drag. Below ρ = ½ it
dominates. 1/ρ is the variance inflation factor of μ beside a law of force that is free
at every place. Neither wrenches nor a field enter: ρ is that of the motion alone.

Source: R. Frisch, F. V. Waugh, Econometrica 1 (1933), 387; D. W. Marquardt,
Technometrics 12 (1970), 591 (variance inflation). See docs/method/friction.md.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.problem.terms.depth_profile import voxel_depths

#: Below this share drag is taken for an elastic force: the error of the law of force
#: would have the larger weight in μ [–]
LEAST_DISTINCT = 0.5

#: The reason that is reported
ONE_SENSE = "sliding in one sense only, presses were not released"


def distinct_drag(scene: Scene, rows: sp.csr_array) -> float:
    """ρ, the share of drag that no elastic force explains, from 0 to 1.

    The pressure is taken in proportion to depth. Frames at which the force turns from
    rising to falling or back are left out: the velocity there is that of neither side.

    Args:
        scene: Probe, motion and rows of contact.
        rows: Force rows of Coulomb drag over the field, shape (3T, V).

    Returns:
        ρ; 0 if nothing slides.
    """
    pressure = np.maximum(voxel_depths(scene.voxmap), 0.0)
    elastic = (scene.N @ pressure).reshape(-1, 3)
    drag = -(rows @ pressure).reshape(-1, 3)
    kept = ~_turning(np.linalg.norm(elastic, axis=1), scene.trajectory.segment)
    return distinct_share(elastic[kept], drag[kept], scene.places[kept])


def distinct_share(elastic: Array, drag: Array, place: IntArray) -> float:
    """ρ of given forces.

    Args:
        elastic: Force without friction, shape (n, 3) [N].
        drag: Drag per unit μ, shape (n, 3) [N].
        place: Place of every frame, shape (n,) [–].
    """
    size = np.linalg.norm(elastic, axis=1, keepdims=True)
    unit = elastic / np.where(size > 0.0, size, 1.0)
    along = np.einsum("ti,ti->t", unit, drag)
    across = ((drag - along[:, None] * unit) ** 2).sum(axis=1)
    adds, takes, aside = (
        np.bincount(place, squares)
        for squares in (
            np.maximum(along, 0.0) ** 2,
            np.minimum(along, 0.0) ** 2,
            across,
        )
    )
    both = adds + takes
    total = float((both + aside).sum())
    if not total:
        return 0.0
    reversing = 4.0 * adds * takes / np.where(both > 0.0, both, 1.0)
    return float((aside + reversing).sum()) / total


def _turning(size: Array, segment: IntArray) -> Mask:
    """Frames at which the force turns from rising to falling or back, shape (T,)."""
    rise = np.where(np.diff(segment) == 0, np.diff(size), 0.0)
    return np.concatenate([[False], rise[1:] * rise[:-1] < 0.0, [False]])[: len(size)]
