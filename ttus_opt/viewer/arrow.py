"""An arrow that is moved: viser builds its own arrows anew whenever they change."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.probe.cylindrical import TURN
from ttus_opt.probe.mesh import TriangleMesh

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
                f"{name}/{part}", mesh.vertices, mesh.faces, color=colour,
                cast_shadow=False, receive_shadow=False,
            )
            for part, mesh in (
                ("shaft", _tube(SHAFT, SHAFT, 1.0)), ("head", _tube(HEAD, 0.0, TIP))
            )
        )  # fmt: skip

    def show(self, start: Array, way: Array) -> None:
        """Draw it from a point (3,) along a vector (3,) that is not zero [m].

        One shorter than its head is as long as the next multiple of `STEP`.
        """
        length = float(np.linalg.norm(way))
        self._frame.position = start
        x, y, z = way / length
        # half-way from the third axis to the way; down, about the second axis
        turn = np.array([1.0 + z, -y, x or np.finfo(float).tiny, 0.0])
        self._frame.wxyz = turn / math.hypot(*turn)
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


def _tube(low: float, high: float, height: float) -> TriangleMesh:
    """A closed tube along z from a radius to another [m]."""
    angle = np.arange(SECTIONS) * TURN / SECTIONS
    rings = [
        np.stack([r * np.cos(angle), r * np.sin(angle), np.full(SECTIONS, z)], axis=1)
        for r, z in ((low, 0.0), (high, height))
    ]
    points = np.concatenate(rings)
    return TriangleMesh(points, np.arange(3)[None]).convex_hull()
