"""The camera of a page until somebody turns it.

viser has one first camera for all pages, and a page may apply it after what it was sent
meanwhile, or get its shape later. A page that reports the first camera of another
shape is therefore told its own, whenever it reports.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.scan.surface import Surface
from ttus_opt.viewer.guarded_server import BROWSER

if TYPE_CHECKING:
    import viser

#: Vertical field of view [deg]
FIELD_OF_VIEW = 35.0

#: Shapes of a picture, by its least width, of its height: distance of the camera, of
#: the size of what is shown, so that it fits; and how far up it is moved, of its size,
#: as the panel of a phone covers the lower half [–]
SHAPES = ((0.8, 2.7, 0.0), (0.6, 3.6, 0.0), (0.0, 5.0, 0.95))

#: A picture no wider is a phone's, if it is not wide for its height [px]; a phone's own
#: pixels are several times as many, but its browser calls itself one
PHONE, CALLED = 430, "Mobi"

#: Two cameras this far apart are one: pages compute with 32 bits [m]
SAME = 1e-3


@dataclass(frozen=True)
class FirstCamera:
    """Where one looks from.

    Attributes:
        front: Direction that is up in the scene, shape (3,) [–].
        away: Direction from what is shown to the camera, shape (3,) [–].
        cameras: For each of the `SHAPES`, position of the camera and the point in the
            middle of the picture, (3,) each [m].
    """

    front: Array
    away: Array
    cameras: tuple[tuple[Array, Array], ...]

    @classmethod
    def of(cls, surface: Surface, length: float) -> FirstCamera:
        """Look at patients in a row.

        Args:
            surface: Of the patients.
            length: From the first slice of the first to the last of the last [m].
        """
        front, along = surface.front, np.array([0.0, 0.0, 1.0])
        middle = (float(surface.z[0]) + 0.5 * length) * along
        size = max(length, 2.0 * float(surface.radius.max()))
        away = 0.8 * front + 0.4 * np.cross(along, front) + 0.45 * along
        up = front - (front @ away) * away / (away @ away)
        up *= size / np.linalg.norm(up)
        cameras = [
            (middle - higher * up + far * size * away, middle - higher * up)
            for _, far, higher in SHAPES
        ]
        return cls(front, away, tuple(cameras))

    def show_on(self, server: viser.ViserServer) -> None:
        """Give every page of a server its camera."""
        camera, (position, middle) = server.initial_camera, self.cameras[0]
        camera.position, camera.look_at = tuple(position), tuple(middle)
        camera.fov = float(np.radians(FIELD_OF_VIEW))

        async def connected(client: Any) -> None:
            async def reported(camera: Any) -> None:
                self.settle(camera, phone=CALLED in BROWSER.get())

            client.camera.on_update(reported)

        server.on_client_connect(connected)

    def settle(self, camera: Any, *, phone: bool = False) -> None:
        """Move a page's camera, where it still is the first one of another shape."""
        wide = [
            camera.image_width >= least * camera.image_height for least, *_ in SHAPES
        ]
        own = wide.index(True)
        if own > 0 and (phone or camera.image_width <= PHONE):
            own = len(SHAPES) - 1
        for k, (position, _) in enumerate(self.cameras):
            if k != own and np.allclose(camera.position, position, 0.0, SAME):
                camera.position, camera.look_at = self.cameras[own]
                return
