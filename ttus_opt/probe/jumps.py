"""Steps of a path that no hand or robot makes, given the steps around them."""

from __future__ import annotations

import numpy as np

from ttus_opt.core.arrays import Array, Mask

#: A step that differs from both its neighbours by more than this [m], than this
#: acceleration makes it [m/s²], and than so many times the median, is a jump
JUMP, BRISK, JUMPS = 0.01, 15.0, 10.0


def jumps(position: Array, time: Array) -> tuple[Mask, Array]:
    """Steps of a path that no hand or robot makes, given the steps around them.

    Args:
        position: Shape (T, 3) [m].
        time: Increasing, shape (T,) [s].

    Returns:
        Mask of the frames after such a step, shape (T,), and by how much every step
        differs from those before and after it, the lesser of both, shape (T,) [m].
    """
    off = np.zeros(len(time))
    if len(time) < 4:
        return off > 0.0, off
    steps = np.diff(time)
    velocity = np.diff(position, axis=0) / steps[:, None]
    change = np.linalg.norm(np.diff(velocity, axis=0), axis=1)
    change = np.pad(change, 1, mode="edge")
    off[1:] = np.minimum(change[:-1], change[1:]) * steps
    plausible = np.maximum(JUMP, BRISK * np.r_[0.0, steps] ** 2)
    return off > np.maximum(plausible, JUMPS * np.median(off[1:])), off
