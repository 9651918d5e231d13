"""What a hand could tell apart: the least differences of force that people notice.

Magnitudes differ noticeably by more than about 7 % (between 2.5 and 10 N) and by more
than about 0.36 N, directions by more than 18 to 26° (the figures the paper judges its
errors by).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ttus_opt.arrays import Array

#: Least noticeable difference of a force: relative [–], absolute [N], direction [°]
NOTICEABLE_SHARE, NOTICEABLE_FORCE, NOTICEABLE_ANGLE = 0.07, 0.36, 18.0


def noticeable(force: Array, force_hat: Array, angle: Array) -> NDArray[np.bool_]:
    """Frames whose rendered force a hand could tell from the measured one.

    Args:
        force: Measured, shape (T, 3) [N].
        force_hat: Rendered, shape (T, 3) [N].
        angle: Between them, 0 where there is no direction, shape (T,) [°].

    Returns:
        True where the magnitudes differ by more than both limits or the directions
        by more than theirs, shape (T,).

    >>> f, g = np.array([[10.0, 0, 0]]), np.array([[10.5, 0, 0]])
    >>> noticeable(f, g, np.zeros(1)).item(), noticeable(f, g, np.full(1, 19.0)).item()
    (False, True)
    """
    size = np.linalg.norm(force, axis=1)
    error = np.abs(np.linalg.norm(force_hat, axis=1) - size)
    larger = np.maximum(NOTICEABLE_FORCE, NOTICEABLE_SHARE * size)
    return np.asarray((error > larger) | (angle > NOTICEABLE_ANGLE))
