"""Poses of a rigid body from the positions of its markers.

The body's frame: origin in its first marker, x towards the second, z normal to the
plane with the third, in the mean shape of all frames. Every frame's pose is the least-
squares motion of the mean shape to the markers that were seen, three or more.
"""

from __future__ import annotations

import numpy as np

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.probe.pose import to_quaternions

#: Rounds in which the mean shape and the poses are found in turn
ROUNDS = 4

#: Markers closer to one line than this give no rotation [m]
LEAST_WIDTH = 1e-3


def body_poses(points: Array) -> tuple[Array, Array, float] | None:
    """Positions (T, 3) [m], quaternions w, x, y, z (T, 4), and what is left [m].

    Args:
        points: Its markers, NaN where not seen, shape (T, m, 3) [m].

    Returns:
        Poses of a rigid body, NaN for frames with fewer than three markers, and the
        root-mean-square distance of the markers from it; None where no frame has all
        markers, or they lie on one line.
    """
    seen: Mask = np.asarray(np.isfinite(points).all(axis=2), dtype=bool)
    whole: Mask = np.asarray(seen.all(axis=1), dtype=bool)
    if not whole.any():
        return None
    shape = points[np.argmax(whole)]
    if np.linalg.svd(shape - shape.mean(axis=0))[1][1] < LEAST_WIDTH:
        return None
    for _ in range(ROUNDS):
        turn, shift = _fitted(shape, points[whole], seen[whole])
        back = np.einsum("tji,tmj->tmi", turn, points[whole] - shift[:, None])
        shape = back.mean(axis=0)
    origin, frame = shape[0], _frame(shape)
    able: Mask = np.asarray(seen.sum(axis=1) >= 3, dtype=bool)
    position = np.full((len(points), 3), np.nan)
    quaternion = np.full((len(points), 4), np.nan)
    turn, shift = _fitted(shape, points[able], seen[able])
    position[able] = turn @ origin + shift
    quaternion[able] = to_quaternions(turn @ frame)
    away = points[able] - (shape @ turn.transpose(0, 2, 1) + shift[:, None])
    off = float(np.sqrt((away[seen[able]] ** 2).sum(axis=1).mean()))
    return position, quaternion, off


def _frame(shape: Array) -> Array:
    """Axes of the body's frame, columns, shape (3, 3)."""
    x = shape[1] - shape[0]
    z = np.cross(x, shape[2] - shape[0])
    x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _fitted(shape: Array, points: Array, seen: Mask) -> tuple[Array, Array]:
    """Least-squares motions from the shape to the seen points (Kabsch).

    Returns:
        Rotations (T, 3, 3) and shifts (T, 3) [m].
    """
    weight = seen / seen.sum(axis=1, keepdims=True)
    known = np.where(seen[..., None], points, 0.0)
    middle = np.einsum("tm,tmi->ti", weight, known)
    own = np.einsum("tm,mi->ti", weight, shape)
    spread = np.einsum(
        "tm,tmi,tmj->tij", weight, known - middle[:, None], shape[None] - own[:, None]
    )
    U, _, Vt = np.linalg.svd(spread)
    proper = np.ones((len(points), 3))
    proper[:, 2] = np.sign(np.linalg.det(U @ Vt))
    turn = (U * proper[:, None, :]) @ Vt
    return turn, middle - np.einsum("tij,tj->ti", turn, own)
