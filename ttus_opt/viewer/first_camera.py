"""The camera of a page until somebody turns it.

viser has one first camera for all pages, and a page may apply it after what it was sent
meanwhile, or get its shape later. A page that reports the first camera of the other
shape is therefore told its own, whenever it reports.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.scan.surface import Surface

if TYPE_CHECKING:
    import viser

#: Vertical field of view [deg]
FIELD_OF_VIEW = 35.0

#: Distance of the camera, of what is shown [–]
AWAY = 2.7

#: Width of a narrow picture, of its height: what is shown would not fit [–]
NARROW = 0.8

#: Distance on a narrow page, and how far up the picture what is shown is then moved, of
#: its size: the panel of a phone covers the lower half [–]
NARROW_AWAY, NARROW_UP = 5.0, 0.95

#: Two cameras this far apart are one: pages compute with 32 bits [m]
SAME = 1e-3


@dataclass(frozen=True)
class FirstCamera:
    """Where one looks from.

    Attributes:
        front: Direction that is up in the scene, shape (3,) [–].
        away: Direction from what is shown to the camera, shape (3,) [–].
        wide: Position of the camera and the point in the middle of the picture, (3,)
            each [m].
        narrow: The same on a page that is much higher than wide.
    """

    front: Array
    away: Array
    wide: tuple[Array, Array]
    narrow: tuple[Array, Array]

    @classmethod
    def of(cls, surface: Surface, length: float) -> FirstCamera:
        """Look at patients in a row.

        Args:
            surface: Of the patients.
            length: From the first slice of the first to the last of the last [m].
        """
        front, along = front_of(surface), np.array([0.0, 0.0, 1.0])
        middle = (float(surface.z[0]) + 0.5 * length) * along
        size = max(length, 2.0 * float(surface.radius.max()))
        away = 0.8 * front + 0.4 * np.cross(along, front) + 0.45 * along
        up = front - (front @ away) * away / (away @ away)
        below = middle - NARROW_UP * size * up / np.linalg.norm(up)
        wide = middle + AWAY * size * away, middle
        return cls(front, away, wide, (below + NARROW_AWAY * size * away, below))

    def show_on(self, server: viser.ViserServer) -> None:
        """Give every page of a server its camera."""
        camera, (position, middle) = server.initial_camera, self.wide
        camera.position, camera.look_at = tuple(position), tuple(middle)
        camera.fov = float(np.radians(FIELD_OF_VIEW))

        async def connected(client: Any) -> None:
            async def reported(camera: Any) -> None:
                self.settle(camera)

            client.camera.on_update(reported)

        server.on_client_connect(connected)

    def settle(self, camera: Any) -> None:
        """Move a page's camera, where it still is the first one of another shape."""
        own, other = self.wide, self.narrow
        if camera.image_width < NARROW * camera.image_height:
            own, other = other, own
        if np.allclose(camera.position, other[0], rtol=0.0, atol=SAME):
            camera.position, camera.look_at = own


def front_of(surface: Surface) -> Array:
    """Direction from the axis to the middle of what the scan saw; +y if all was."""
    weight = surface.observed.mean(axis=1)
    towards = np.array(
        [weight @ np.cos(surface.theta), weight @ np.sin(surface.theta), 0.0]
    )
    size = float(np.linalg.norm(towards)) / len(weight)
    return towards / np.linalg.norm(towards) if size > 0.02 else np.array([0, 1.0, 0])
