"""Just noticeable differences of force.

People notice differences in magnitude above about 7 % (between 2.5 and 10 N) and above
about 0.36 N, and differences in direction above 18 to 26°. The paper compares its
errors with these figures.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array

#: Just noticeable differences of a force: relative [–], absolute [N], direction [°]
NOTICEABLE_SHARE, NOTICEABLE_FORCE, NOTICEABLE_ANGLE = 0.07, 0.36, 18.0


def noticeable(force: Array, force_hat: Array, angle: Array) -> NDArray[np.bool_]:
    """Whether a person could notice the difference between two forces.

    Args:
        force: Measured force, shape (T, 3) [N].
        force_hat: Rendered force, shape (T, 3) [N].
        angle: Angle between them, 0 where undefined, shape (T,) [°].

    Returns:
        True where the magnitudes differ by more than both of their limits, or the
        directions by more than theirs, shape (T,).

    >>> f, g = np.array([[10.0, 0, 0]]), np.array([[10.5, 0, 0]])
    >>> noticeable(f, g, np.zeros(1)).item(), noticeable(f, g, np.full(1, 19.0)).item()
    (False, True)
    """
    size = np.linalg.norm(force, axis=1)
    error = np.abs(np.linalg.norm(force_hat, axis=1) - size)
    larger = np.maximum(NOTICEABLE_FORCE, NOTICEABLE_SHARE * size)
    return np.asarray((error > larger) | (angle > NOTICEABLE_ANGLE))
