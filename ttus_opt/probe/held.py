"""How a probe is held: which of its axes points into the patient, which to the head."""

from __future__ import annotations

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError

#: How the phantom's probe is held: z into the patient, y to the feet
USUAL = ("z", "-y")

AXES = {
    sign + name: (-1.0 if sign else 1.0) * np.eye(3)[k]
    for k, name in enumerate("xyz")
    for sign in ("", "-")
}


def hold(held: tuple[str, str] = USUAL) -> Array:
    """Orientation of a held probe relative to the skin's frame, shape (3, 3).

    Its columns are the probe's axes, its rows outward, around and along the body, as
    `ttus_opt.contact.standing` takes it.

    Args:
        held: The probe's axes that point into the patient and to the head.

    Raises:
        InputError: Unknown or equal axes.
    """
    into, head = held_axes(held)
    return np.stack([-into, np.cross(head, -into), head])


def held_axes(held: tuple[str, str]) -> tuple[Array, Array]:
    """The probe's axes into the patient and to the head by name, shape (3,) each.

    Raises:
        InputError: Unknown or equal axes.
    """
    if len(held) != 2 or not all(name in AXES for name in held):
        raise InputError(
            "held names the probe's axes into the patient and to the head, each one of "
            f"{', '.join(AXES)}: got {held}"
        )
    into, head = (AXES[name] for name in held)
    if into @ head != 0.0:
        raise InputError(
            f"held names the same axis of the probe twice, {held[0]} and {held[1]}: "
            "one points into the patient, another to the head"
        )
    return into, head
