"""Where drag acts, and the depth map beside it, by marginal likelihood.

The Laplace field hardly tells drag of every point from that of the patch: what it has
wrong of the forces is larger than what they differ by. Where its likelihoods are within
the threshold at which drag itself is shown, the depth map's decide, of the same normal
forces with each one's drag taken from the rows.
"""

from __future__ import annotations

from typing import Any

from ttus_opt.contact.friction import DEADBAND
from ttus_opt.contact.scene import Scene
from ttus_opt.problem.terms.depth_map_estimate import (
    DepthMapEstimate,
    estimate_depth_map,
)
from ttus_opt.problem.terms.drag_estimate import DragEstimate, alike_drag


def estimate_dragged(
    scene: Scene,
    acts_at: str = "auto",
    deadband: float = DEADBAND,
    largest: float = 1.0,
    **options: Any,
) -> tuple[DragEstimate, DepthMapEstimate]:
    """The likeliest drag and the depth map with it.

    Args:
        scene: A scene with measured wrenches.
        acts_at: As of `estimate_drag`.
        deadband: The same [m/s].
        largest: Largest μ [–].
        options: Of `estimate_depth_map`.

    Raises:
        InputError: As of both.
        UnusableForcesError: As of `estimate_depth_map`.
    """
    found = []
    for drag in alike_drag(scene, acts_at, deadband):
        mu = min(drag.friction_coefficient, largest)
        rows = scene.N - mu * drag.drag.rows.force
        found.append((drag, estimate_depth_map(scene, rows, **options)))
    return max(found, key=lambda one: one[1].log_evidence)
