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
    off[1:] = unlike_neighbours(position, steps)
    plausible = np.maximum(JUMP, BRISK * np.r_[0.0, steps] ** 2)
    return off > np.maximum(plausible, JUMPS * np.median(off[1:])), off


def unlike_neighbours(path: Array, steps: Array) -> Array:
    """By how much every step of a path (T, 3) differs from those before and after it.

    The lesser of both, over steps of the time, shape (T - 1,).
    """
    change = np.diff(np.diff(path, axis=0) / steps[:, None], axis=0)
    size = np.pad(np.linalg.norm(change, axis=1), 1, mode="edge")
    return np.asarray(np.minimum(size[:-1], size[1:]) * steps)
