"""Do recordings touch the patient in more than one spot? Elsewhere the prior holds."""

from __future__ import annotations

import warnings

import numpy as np

from ttus_opt.errors import TtusWarning
from ttus_opt.scene import Scene

#: Contacts within this distance of their centre, along the surface, are one spot [m]
SPOT = 0.005

#: Fewest frames in contact for a spread [–]
LEAST = 20


def contact_spread(scene: Scene) -> float:
    """Largest distance of a contact from the contacts' centre, along the surface [m].

    NaN where fewer than `LEAST` frames are in contact.
    """
    touching = scene.rows.contact_points > 0
    if touching.sum() < LEAST:
        return float("nan")
    poses = scene.trajectory
    at = poses.position + poses.rotation @ np.asarray(scene.shell.reference)
    x, y, z = at[touching].T
    middle = np.arctan2(np.median(y), np.median(x))
    turned = np.angle(np.exp(1j * (np.arctan2(y, x) - middle)))
    along = z - np.median(z)
    return float(np.hypot(np.hypot(x, y) * turned, along).max())


def warn_of_one_spot(scene: Scene) -> None:
    """Warn when all contacts are in one spot."""
    spread = contact_spread(scene)
    if spread < SPOT:
        warnings.warn(
            f"all frames in contact lie within {1e3 * spread:.1f} mm of one spot: "
            "elsewhere the field is only the prior; record presses at several places",
            TtusWarning,
            stacklevel=2,
        )
