"""One field's patient and probe as nodes of the page's scene.

A skin is drawn as soon as it is known: a browser takes its time over the first picture,
and what the probe needs takes as long to load.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

import numpy as np

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.probe.pose import to_quaternions
from ttus_opt.scan.surface import Surface
from ttus_opt.viewer.arrow import Arrow
from ttus_opt.viewer.colour_map import MARK, MEASURED, UNKNOWN, Pixels, section_pixels
from ttus_opt.viewer.first_camera import FirstCamera
from ttus_opt.viewer.guarded_server import Served
from ttus_opt.viewer.looks import lit
from ttus_opt.viewer.skin import SkinMesh

if TYPE_CHECKING:
    import viser

    from ttus_opt.probe.mesh import TriangleMesh
    from ttus_opt.viewer.section import Section
    from ttus_opt.viewer.touch import Touch

#: Distance between two patients, of a body's length [–]
APART = 1.15

#: Length of an arrow per force [m/N] and per torque [m/(N m)]
PER_FORCE, PER_TORQUE = 0.008, 0.8

#: Least force and torque that have an arrow [N], [N m]
LEAST_FORCE, LEAST_TORQUE = 0.02, 2e-4

#: Recorded arrows: radius of shaft and head, and length of the head [m]
SMALL = {"shaft_radius": 0.0007, "head_radius": 0.0016, "head_length": 0.004}

#: Height of a mark's number over the skin, which hides the numbers behind it [m]
ABOVE = 0.012

#: Colours of probe and torque
PROBE, TORQUE = (238, 240, 244), (28, 122, 92)


class PatientNodes:
    """The nodes below ``/NAME``, at first a grey skin.

    Args:
        scene: The page's scene.
        name: Of the nodes.
        skin: Nodes of the skin.
        offset: Where the patient's origin is in the scene, shape (3,) [m].
        first: Of the pages; the camera looks into a cut.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        name: str,
        skin: SkinMesh,
        offset: Array,
        first: FirstCamera,
    ) -> None:
        self._scene, self._name, self._first = scene, name, first
        self.skin, self.offset = skin, offset
        self._grey = np.full((len(skin.theta), 3), UNKNOWN, dtype=np.uint8)
        self._colours: Pixels = self._grey
        self._faces: IntArray = skin.faces
        self._painting = threading.Lock()  # colours and cuts come from two threads
        self._marks: list[Any] = []
        scene.add_frame(f"/{name}", show_axes=False, position=tuple(offset))
        self._mesh = scene.add_glb(
            f"/{name}/skin", self._glb(), cast_shadow=False, receive_shadow=False
        )
        self._image = scene.add_image(
            f"/{name}/section", np.zeros((1, 1, 4), np.uint8), 1.0, 1.0, visible=False,
            cast_shadow=False, receive_shadow=False,
        )  # fmt: skip
        self.probe: Any = None

    def add_probe(self, mesh: TriangleMesh, colour: tuple[int, int, int]) -> None:
        """Draw a probe, its mesh in the probe frame, and its forces in a colour."""
        self._colour = colour
        self.probe = self._scene.add_mesh_simple(
            f"/{self._name}/probe", mesh.vertices, mesh.faces, color=PROBE,
            opacity=0.6, flat_shading=False, side="double", cast_shadow=False,
        )  # fmt: skip
        tints = {"force": colour, "torque": TORQUE, "measured": MEASURED}
        self._force, self._torque, self._measured = (
            Arrow(self._scene, f"/{self._name}/{what}", tint)
            for what, tint in tints.items()
        )

    def colour(self, colours: Pixels, marks: Array) -> None:
        """Colour the nodes, shape (n, 3), and number places, shape (k, 3) [m]."""
        self._paint(colours, None)
        for old in self._marks:
            old.remove()  # and its number
        self._marks = []
        for k, place in enumerate(marks):
            one = f"/{self._name}/mark{k + 1}"
            at = tuple(place.tolist())
            ball = self._scene.add_icosphere(one, 0.004, color=MARK, position=at)
            outward = place * [1.0, 1.0, 0.0] / np.hypot(place[0], place[1])
            self._scene.add_label(
                f"{one}/number", str(k + 1), position=tuple(ABOVE * outward),
                depth_test=True, anchor="bottom-center",
            )  # fmt: skip
            self._marks.append(ball)

    def blank(self) -> None:
        """Colour nothing and number nothing."""
        self.colour(self._grey, np.zeros((0, 3)))

    def show_section(self, shown: Section | None) -> None:
        """Draw a section and cut the skin open there; None closes it."""
        faces = self.skin.faces
        if shown is not None:
            normal = shown.normal * (
                1.0 if shown.normal @ self._first.away > 0 else -1.0
            )
            faces = self.skin.cut(normal, float(shown.origin @ normal))
        if not np.array_equal(faces, self._faces):
            self._paint(None, faces)
        if shown is None:
            self._image.visible = False
            return
        # the picture's rows go down, its normal points at the one who looks
        axes = np.stack([shown.across, -shown.up, -shown.normal], axis=1)
        image = self._image
        image.wxyz, image.position = to_quaternions(axes[None])[0], shown.origin
        image.render_width, image.render_height = shown.size
        image.image, image.visible = section_pixels(shown), True

    def show_recording(self, starts: Array, measured: Array, rendered: Array) -> None:
        """Draw recorded places with their forces.

        Args:
            starts: Where the arrows begin, shape (k, 3) [m].
            measured: Forces, NaN where none were, shape (k, 3) [N].
            rendered: Forces, shape (k, 3) [N].
        """
        for what, forces, colour in (
            ("rendered", rendered, self._colour),
            ("felt", measured, MEASURED),
        ):
            known = np.linalg.norm(forces, axis=1) > LEAST_FORCE
            if known.any():
                ends = starts + PER_FORCE * forces
                points = np.stack([starts, ends], axis=1)[known]
                name = f"/{self._name}/recording/{what}"
                self._scene.add_arrows(name, points, colour, **SMALL)

    def show_touch(self, touch: Touch, measured: Array | None) -> None:
        """Move the probe and its arrows."""
        self.probe.wxyz = to_quaternions(touch.rotation[None])[0]
        self.probe.position = touch.position
        wrench = touch.wrench
        felt = np.zeros(3) if measured is None else measured
        for arrow, start, vector, scale, least in (
            (self._force, touch.centre, wrench.force, PER_FORCE, LEAST_FORCE),
            (self._torque, touch.reference, wrench.torque, PER_TORQUE, LEAST_TORQUE),
            (self._measured, touch.centre, felt, PER_FORCE, LEAST_FORCE),
        ):
            if np.linalg.norm(vector) > least:
                arrow.show(start, scale * vector)
            else:
                arrow.hide()

    def _paint(self, colours: Pixels | None, faces: IntArray | None) -> None:
        """Draw the skin with other colours or faces, None for those it has."""
        with self._painting:
            self._colours = self._colours if colours is None else colours
            self._faces = self._faces if faces is None else faces
            self._mesh.glb_data = self._glb()

    def _glb(self) -> bytes:
        light = lit(self._colours, self.skin.normals, self._first.front)
        return self.skin.glb(light, self._faces)


def patients_on(served: Served, surface: Surface, count: int) -> list[PatientNodes]:
    """Patients of one skin in a row on pages, drawn by the first call.

    Args:
        served: The pages; their camera looks at the skin.
        surface: The skin.
        count: Of patients [–].
    """
    if served.patients:
        return served.patients
    server, skin = served.server, SkinMesh.of(surface)
    length = float(surface.z[-1] - surface.z[0])
    offsets = [np.array([0.0, 0.0, k * APART * length]) for k in range(count)]
    first = FirstCamera.of(surface, length + float(offsets[-1][2]))
    with server.atomic():
        server.scene.set_up_direction(tuple(first.front.tolist()))
        first.show_on(server)
        served.patients.extend(
            PatientNodes(server.scene, f"patient{k}", skin, offset, first)
            for k, offset in enumerate(offsets)
        )
    return served.patients
