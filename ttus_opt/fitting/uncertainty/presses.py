"""Places of a scene that are left out together."""

from __future__ import annotations

import numpy as np

from ttus_opt.contact.places import places
from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array, IntArray

#: Presses nearer than this part of the probe's size are at the same place [–]
SAME = 0.25

#: Fewest presses that are places; fewer are long lines, which are divided [–]
LEAST_PRESSES = 4


def pressed_places(scene: Scene) -> IntArray:
    """Number of every frame's place, shape (T,).

    A place is a press with its repetitions, or a whole line along the skin: predicting
    a press from another one at the same place tells nothing about a new place. Of fewer
    than `LEAST_PRESSES` it is as large as the probe.
    """
    press, position = scene.presses, scene.trajectory.position
    size, out = scene.shell.rms_radius, press.copy()
    numbers = np.unique(press[scene.touching]).tolist()
    if len(numbers) < LEAST_PRESSES:
        return places(press, position, size)
    known: dict[int, Array] = {}
    for number in numbers:
        at_press = position[press == number]
        middle = at_press.mean(axis=0)
        if np.linalg.norm(at_press - middle, axis=1).max() > size:
            continue
        far = {one: float(np.linalg.norm(at - middle)) for one, at in known.items()}
        nearest = min(far, key=far.__getitem__, default=-1)
        if nearest >= 0 and far[nearest] < SAME * size:
            out[press == number] = nearest
        else:
            known[number] = middle
    return out
