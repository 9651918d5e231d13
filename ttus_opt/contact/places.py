"""Runs of frames whose errors are alike: presses, and places within a press."""

from __future__ import annotations

import numpy as np

from ttus_opt.core.arrays import Array, IntArray, Mask

#: Largest distance of the probe from the start of a place [m]
PLACE = 0.03


def runs(touching: Mask, segment: IntArray) -> IntArray:
    """Number of every frame's run, in contact or in the air, shape (T,).

    Args:
        touching: Whether a frame is in contact, shape (T,).
        segment: Recording of every frame, shape (T,) [–].
    """
    begins = (np.diff(touching.astype(np.int8)) != 0) | (np.diff(segment) != 0)
    return np.concatenate([[0], np.cumsum(begins)]).astype(np.int64)


def places(press: IntArray, position: Array, size: float = PLACE) -> IntArray:
    """Number of every frame's place, shape (T,).

    A place is a run of frames of one press within ``size`` of its first position.

    Args:
        press: Press of every frame, shape (T,) [–].
        position: Position of the probe, shape (T, 3) [m].
        size: Largest distance from the first position [m].
    """
    out, number, start = np.zeros(len(press), dtype=np.int64), 0, 0
    for t in range(1, len(press)):
        away = float(np.linalg.norm(position[t] - position[start]))
        if press[t] != press[start] or away > size:
            number, start = number + 1, t
        out[t] = number
    return out
