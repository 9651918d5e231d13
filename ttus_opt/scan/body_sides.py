"""Which side of a body is its front, and which end its head.

A person lies with the back on the support. Without a support the back is the flatter
side: more skin lies near it, so the mean of the skin's points is nearer to the back
than the midpoint between back and front. The head is at the deeper end of the trunk: a
chest or belly stands higher than a pelvis. With D(z) the depth of sections (above the
support, or from back to front), the sign of z is the sign of the slope of a line fitted
to D(z) over the middle four fifths of the length.

Both rules use the body alone, so that turning the scan does not change them. Both are
guesses: below `CLEAR` a warning says so, and what the user states is never guessed.
"""

from __future__ import annotations

import itertools

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import GeometryError, InputError, warn

#: A difference between the sides below this share of the depth is doubtful [–]
CLEAR = 0.02

#: Sections along the body, and the share of its length they cover in the middle
SECTIONS, MIDDLE = 16, 0.8

#: Largest angle between the stated direction to the head and the body's axis [rad]
LARGEST_ANGLE = np.radians(75.0)


def front_along(depth: Array) -> float:
    """Whether the front lies at larger depths, by the flatter side.

    Args:
        depth: Depth of skin points all around, either sign, shape (n,) [m].

    Returns:
        1.0, or -1.0 if the front lies at smaller depths.
    """
    low, high = np.percentile(depth, [2, 98])
    lean = (0.5 * (low + high) - depth.mean()) / (high - low)
    if abs(lean) < 0.5 * CLEAR:
        _uncertainty("which side is the front", "prone=True turns it over")
    return 1.0 if lean >= 0.0 else -1.0


def head_along(z: Array, depth: Array, *, supported: bool) -> float:
    """Whether the head lies at larger z, by the deeper end.

    Args:
        z: z of skin points, along the body in either direction, shape (n,) [m].
        depth: The points' coordinate towards the front, shape (n,) [m].
        supported: Depths are heights above the support, so that the highest points of
            a section give its depth; otherwise highest minus lowest.

    Returns:
        1.0, or -1.0 if the head lies at smaller z.
    """
    low, high = np.percentile(z, [1, 99])
    margin = 0.5 * (1.0 - MIDDLE) * (high - low)
    edges = np.linspace(low + margin, high - margin, SECTIONS + 1)
    middles, depths = [], []
    for start, end in itertools.pairwise(edges.tolist()):
        section = depth[(z >= start) & (z < end)]
        if len(section) < 8:
            continue
        back, front = np.percentile(section, [5, 95])
        middles.append(0.5 * (start + end))
        depths.append(front if supported else front - back)
    if len(middles) < 3:
        _uncertainty_head()
        return 1.0
    slope = float(np.polyfit(middles, depths, 1)[0])
    if abs(slope) * (edges[-1] - edges[0]) < CLEAR * float(np.mean(depths)):
        _uncertainty_head()
    return 1.0 if slope >= 0.0 else -1.0


def checked_direction(head: Array) -> Array:
    """A direction to the head, of length 1.

    Raises:
        InputError: Not three finite numbers, or zero.
    """
    direction = np.asarray(head, dtype=np.float64)
    if direction.shape != (3,) or not np.isfinite(direction).all():
        raise InputError(f"head must be a direction x,y,z in the scan, got {head}")
    length = float(np.linalg.norm(direction))
    if length == 0.0:
        raise InputError(
            "head must not be zero: give a direction in the scan, like 0,0,1"
        )
    return direction / length


def sign_towards(z: Array, head: Array) -> float:
    """The sign that turns z towards the head.

    Args:
        z: The body's axis in the scan, either way, shape (3,) [–].
        head: Direction to the head in the scan, unit length, shape (3,) [–].

    Raises:
        GeometryError: The direction points across the body.
    """
    along = float(z @ head)
    if abs(along) < np.cos(LARGEST_ANGLE):
        angle = np.degrees(np.arccos(abs(along)))
        raise GeometryError(
            f"head points {angle:.0f}° away from the body's axis, which runs along "
            f"({', '.join(f'{v:.2f}' for v in z)}) in the scan: give a direction along "
            "the body"
        )
    return float(np.sign(along))


def _uncertainty_head() -> None:
    _uncertainty("which end is the head", "give head=x,y,z, a direction in the scan")


def _uncertainty(what: str, remedy: str) -> None:
    warn(f"the scan hardly shows {what}, so this is a guess: {remedy}", 5)
