"""An arrow that is moved: viser builds its own arrows anew whenever they change."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.probe.cylindrical import TURN
from ttus_opt.probe.pose import to_quaternions

if TYPE_CHECKING:
    import viser

#: Radius of the shaft and of the head, and length of the head [m]
SHAFT, HEAD, TIP = 0.0018, 0.0045, 0.011

#: The shaft's length is a multiple of this; within a head it is hidden [m]
STEP = 0.005

#: Corners around it [–]
SECTIONS = 12


class Arrow:
    """A shaft and a head, hidden until shown.

    Args:
        scene: The page's scene.
        name: Of its node.
        colour: Red, green and blue, 0 to 255.
    """

    def __init__(
        self, scene: viser.SceneApi, name: str, colour: tuple[int, int, int]
    ) -> None:
        self._frame = scene.add_frame(name, show_axes=False, visible=False)
        self._shaft, self._head = (
            scene.add_mesh_simple(
                f"{name}/{part}", *_tube(*sizes), color=colour,
                cast_shadow=False, receive_shadow=False,
            )
            for part, sizes in (
                ("shaft", (SHAFT, SHAFT, 1.0)), ("head", (HEAD, 0.0, TIP))
            )
        )  # fmt: skip

    def show(self, start: Array, way: Array) -> None:
        """Draw it from a point (3,) along a vector (3,) that is not zero [m].

        One shorter than its head is as long as the next multiple of `STEP`.
        """
        length = float(np.linalg.norm(way))
        self._frame.position = start
        self._frame.wxyz = to_quaternions(_turned(way / length)[None])[0]
        bare = max(length - TIP, 0.0)
        self._head.position = (0.0, 0.0, bare)
        # a page takes its time over a size: few changes, whose end the head hides
        shaft = (1.0, 1.0, STEP * (math.floor(bare / STEP) + 1.0))
        head = min(STEP * math.ceil(length / STEP) / TIP, 1.0)
        if self._shaft.scale != shaft:
            self._shaft.scale = shaft
        if self._head.scale != head:
            self._head.scale = head
        if not self._frame.visible:
            self._frame.visible = True

    def hide(self) -> None:
        """Draw nothing."""
        if self._frame.visible:
            self._frame.visible = False


def _turned(axis: Array) -> Array:
    """A rotation (3, 3) that takes the third axis to a unit vector (3,)."""
    least = np.eye(3)[np.abs(axis).argmin()]
    across = np.cross(least, axis)
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(axis, across), axis], axis=1)


def _tube(low: float, high: float, height: float) -> tuple[Array, IntArray]:
    """Vertices and faces of a closed tube along z from a radius to another [m]."""
    angle = np.arange(SECTIONS) * TURN / SECTIONS
    x, y = np.cos(angle), np.sin(angle)
    ends = [[0.0, 0.0, 0.0], [0.0, 0.0, height]]
    rings = [
        np.stack([r * x, r * y, z + 0.0 * x], axis=1)
        for r, z in ((low, 0.0), (high, height))
    ]
    a = 2 + np.arange(SECTIONS)
    b = np.roll(a, -1)
    c, d, zero = a + SECTIONS, b + SECTIONS, 0 * a
    faces = [(zero, b, a), (a, b, d), (a, d, c), (zero + 1, c, d)]
    return np.concatenate([ends, *rings]), np.concatenate(
        [np.stack(f, axis=1) for f in faces]
    )
