"""Does a probe touch before it meets the skin? Of contacts of a few millimetres.

Who finds the skin by first touch notices it late, by the force that a sensor tells from
none: forces then do not begin at zero, but with that force, on the skin. Contacts of a
few millimetres show it, and tenths of a millimetre matter to them: a field that is zero
on the skin is too soft where they begin. The skin is raised in steps as long as the
evidence of a depth map increases. Deep contacts hardly tell such heights, nor need them
(of nine torsos with exact skins, pressed 7 to 10 mm deep, it rises by 2 at most up to
0.5 mm). Where recordings show frames on both sides of the onset, `zero_check` sees it.

See docs/method/rendering.md, Errors.
"""

from __future__ import annotations

import warnings

import numpy as np

from ttus_opt.contact.scene import Scene
from ttus_opt.contact.standing import deepest
from ttus_opt.core.errors import GeometryError, MistakeWarning, TtusWarning, warn
from ttus_opt.core.threads import one_blas_thread
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem.terms.depth_map_estimate import (
    UnusableForcesError,
    estimate_depth_map,
)
from ttus_opt.voxmap.voxmap import Voxmap

#: Median depth of contacts below which tenths of a millimetre matter [m]
SHALLOW = 5e-3

#: Step of the height, and largest height, over that median [–]
STEP, MOST_STEPS = 0.1, 6

#: By how much the evidence must exceed that of the skin as it is [–]
CERTAIN = 10.0


def late_touch(scene: Scene) -> float | None:
    """Height above the skin where forces of shallow contacts begin [m].

    Args:
        scene: A scene.

    Returns:
        The likeliest height; None where contacts are deep, it is not surely above, or
        no forces were measured.
    """
    touching = np.flatnonzero(scene.touching)
    if not len(touching) or not scene.trajectory.has_wrench:
        return None
    own = scene.trajectory.select(touching)
    surface = scene.voxmap.surface
    depth, _ = deepest(surface, scene.shell, own.rotation, own.position)
    median = float(np.median(depth))
    if not 0.0 < median < SHALLOW:
        return None
    step, evidence = STEP * median, list[float]()
    try:
        while len(evidence) <= MOST_STEPS:
            voxmap = scene.voxmap.raised(len(evidence) * step)
            here = _evidence(voxmap, scene.shell, own)
            if evidence and here <= evidence[-1]:
                break
            evidence.append(here)
    except UnusableForcesError:
        return None
    except GeometryError:
        pass  # the grid ends there
    surely = len(evidence) > 1 and evidence[-1] - evidence[0] > CERTAIN
    return (len(evidence) - 1) * step if surely else None


def tell_late_touch(height: float, remedy: str) -> None:
    """Warn of forces that begin above the skin."""
    warn(
        f"forces begin about {1e3 * height:.2g} mm above the skin: was it found by "
        f"first touch, which is noticed late? {remedy}",
        4,
        MistakeWarning,
    )


def _evidence(voxmap: Voxmap, shell: PointShell, contacts: Trajectory) -> float:
    """That of a depth map, of the same frames whatever the skin."""
    with warnings.catch_warnings(), one_blas_thread():
        warnings.simplefilter("ignore", TtusWarning)  # told of the scene itself
        scene = Scene.assemble(voxmap, shell, contacts, sampling="trilinear")
        return estimate_depth_map(scene, resampled=True).log_evidence
