"""What is worth sending: poses and forces that a person can tell from the last sent.

A person notices about 1 mm and 1° of a held tool, and 10 % of a force or 0.36 N,
whichever is more (docs/method/rendering.md, 15; P. Hinterseer et al., IEEE Trans.
Signal Process. 56 (2008) 588-597).
"""

from __future__ import annotations

import math

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.live.messages import Sample

#: Differences that cannot be noticed: of position [m], of rotation [rad], of force [N],
#: of force over that force [–]
POSITION, ANGLE, FORCE, RELATIVE = 1e-3, math.radians(1.0), 0.36, 0.10


def moved(a: tuple[Array, Array], b: tuple[Array, Array]) -> bool:
    """Whether two poses, rotation (3, 3) and position (3,) [m], differ."""
    way, turn = a[1] - b[1], (a[0] - b[0]).ravel()
    # ‖A − B‖² = 8 sin²(φ/2) of the rotation between them
    most = 8.0 * math.sin(0.5 * ANGLE) ** 2
    return bool(way @ way > POSITION**2 or turn @ turn > most)


def differ(a: Sample, b: Sample) -> bool:
    """Whether two samples differ in pose or force."""
    if moved((a.rotation, a.position), (b.rotation, b.position)):
        return True
    size = float(np.linalg.norm(b.wrench[:3]))
    change = float(np.linalg.norm(a.wrench[:3] - b.wrench[:3]))
    return change > max(FORCE, RELATIVE * size)
