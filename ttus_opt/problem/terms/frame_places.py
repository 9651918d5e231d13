"""The place of every frame of a scene."""

from __future__ import annotations

from ttus_opt.contact.places import places, runs
from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import IntArray


def frame_places(scene: Scene) -> IntArray:
    """Number of every frame's place, shape (T,).

    A place is a run of frames of one press within 30 mm (`ttus_opt.contact.places`).
    """
    press = runs(scene.rows.contact_points > 0, scene.trajectory.segment)
    return places(press, scene.trajectory.position)
