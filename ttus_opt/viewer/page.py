"""The page: patients in a scene, tabs beside it, drags and clicks into the state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import TtusError
from ttus_opt.probe.cylindrical import TURN
from ttus_opt.probe.mesh import TriangleMesh
from ttus_opt.probe.pose import from_quaternions, to_quaternions
from ttus_opt.viewer.colour_map import RENDERED
from ttus_opt.viewer.guarded_server import Served
from ttus_opt.viewer.jobs import Jobs
from ttus_opt.viewer.patient_nodes import PatientNodes, patients_on
from ttus_opt.viewer.probe_tab import ProbeTab
from ttus_opt.viewer.readout import readout
from ttus_opt.viewer.recording_tab import RecordingTab
from ttus_opt.viewer.section_tab import SectionTab
from ttus_opt.viewer.skin import place_on_ray
from ttus_opt.viewer.skin_tab import SkinTab
from ttus_opt.viewer.state import ViewState

if TYPE_CHECKING:
    from ttus_opt.viewer.skin_tab import Stated

#: Least squared sine between the skin's normal and the pointer's ray: where one looks
#: along the normal, the probe moves less than the pointer [–]
STEEP = 0.1


class Page:
    """Draws a state and listens to its visitors.

    Attributes:
        server: Of the page.
        state: What is shown.
        names: Of the fields.
        nodes: Patient and probe of every field.
        jobs: Work beside the page.
        tell: Shows a line on every page.
        tabs: Where more tabs may be added.

    Args:
        served: Its pages.
        state: What is shown.
        names: Of the fields.
        mesh: The probe's own mesh, probe frame; None to take its points' hull.
        stated: Uncertainty of the first field's fit.
    """

    def __init__(
        self,
        served: Served,
        state: ViewState,
        names: Sequence[str],
        mesh: TriangleMesh | None = None,
        stated: Stated | None = None,
    ) -> None:
        self.server, self.tell = served.server, served.tell
        self.state, self.names, self.jobs = state, names, Jobs(served.tell)
        self.nodes = patients_on(served, state.surface, len(state.fields))
        server, shell = self.server, state.shell
        if shell is not None:
            if mesh is None:  # a hull does not look at faces
                mesh = TriangleMesh(shell.points, np.arange(3)[None]).convex_hull()
            for one, colour in zip(self.nodes, RENDERED, strict=False):
                one.add_probe(mesh, colour)
        self._numbers = server.gui.add_html("")
        legend = server.gui.add_html("")
        self.tabs = tabs = server.gui.add_tab_group()
        self.probe: ProbeTab | None = None
        self.recording: RecordingTab | None = None
        if shell is not None:
            with (tab := tabs.add_tab("Probe")):
                self.probe = ProbeTab(self, tab)
            self._listen(self.probe)
        with tabs.add_tab("Skin"):
            self.skin = SkinTab(self, legend, stated)
        with tabs.add_tab("Section"):
            self.section = SectionTab(self)
        if state.recording is not None:
            with tabs.add_tab("Recording"):
                self.recording = RecordingTab(self, state.recording)
        self.move()
        self.write()

    def by_hand(self, handle: Any, act: Callable[[Any], object]) -> None:
        """Act when somebody changes an input, not when the viewer itself does.

        Args:
            handle: The input.
            act: Called with its value, in the order of the changes; what it refuses is
                told.
        """

        async def changed(event: Any) -> None:
            if event.client is None:
                return
            try:
                act(event.target.value)
            except TtusError as error:
                self.tell(str(error))

        handle.on_update(changed)

    def by_click(self, button: Any, act: Callable[[], object]) -> None:
        """Act when somebody presses a button; what it refuses is told."""

        def pressed(_: Any) -> None:
            try:
                act()
            except TtusError as error:
                self.tell(str(error))

        button.on_click(pressed)

    def move(self) -> None:
        """Draw probe and forces as they are now; 30 times a second or more."""
        with self.server.atomic():
            for nodes, touch in zip(self.nodes, self.state.touches, strict=False):
                nodes.show_touch(touch, self.state.measured)
            if self.probe is not None and not self._grabbed:
                rotation, position = self.state.pose
                self._handle.wxyz = to_quaternions(rotation[None])[0]
                self._handle.position = position

    def write(self) -> None:
        """Write numbers, fields and plots; a few times a second."""
        state, measured = self.state, self.state.measured
        if measured is None and self.recording is not None and self.recording.has_force:
            measured = np.full(3, np.nan)  # its row stays
        self._numbers.content = readout(
            state.touches, self.names, measured, state.source
        )
        if self.probe is not None:
            self.probe.show()
            self.probe.draw()
        if self.recording is not None:
            self.recording.draw()

    def _listen(self, tab: ProbeTab) -> None:
        """Take drags of the probe and clicks on the skin."""
        rotation, position = self.state.pose
        self._grabbed = False
        self._handle = self.server.scene.add_transform_controls(
            "/patient0/handle", scale=0.09, visible=False, depth_test=False,
            wxyz=to_quaternions(rotation[None])[0], position=position,
        )  # fmt: skip

        async def turned(event: Any) -> None:
            self._grabbed = event.phase != "end"
            R = from_quaternions(np.asarray(self._handle.wxyz)[None], "wxyz")[0]
            self.state.put(R, np.asarray(self._handle.position))

        self._handle.on_update(turned)
        self.by_hand(tab.free, lambda value: setattr(self._handle, "visible", value))
        for nodes in self.nodes:
            self._listen_to(nodes)

        @self.server.scene.on_click()
        def clicked(event: Any) -> None:
            for nodes in self.nodes:
                origin = np.array(event.ray_origin) - nodes.offset
                ray = np.array(event.ray_direction)
                place, met = place_on_ray(self.state.surface, origin, ray)
                if met:
                    self.state.slide(*place)
                    return

    def _listen_to(self, nodes: PatientNodes) -> None:
        """Drags of one patient's probe: over the skin, with shift into it."""
        grip: dict[str, Any] = {}

        async def slid(event: Any) -> None:
            eye = np.asarray(event.client.camera.position) - nodes.offset

            def below(point: tuple[float, float, float]) -> Array:
                ray = np.array(point) - nodes.offset - eye
                return np.array(place_on_ray(self.state.surface, eye, ray)[0])

            if event.phase == "start" or "place" not in grip:
                place = below(event.start_position)
                grip.update(place=place, own=np.array(self.state.place))
            step = below(event.end_position) - grip["place"]
            step[0] = (step[0] + 0.5 * TURN) % TURN - 0.5 * TURN
            theta, z = grip["own"] + step
            self.state.slide(float(theta), float(z))

        async def pressed(event: Any) -> None:
            if event.phase == "start" or "point" not in grip:
                point = np.array(event.start_position)
                grip.update(point=point, depth=self.state.depth)
            eye = np.asarray(event.client.camera.position)
            ray = np.array(event.end_position) - eye
            out = along_line(grip["point"] - eye, self.state.outward, ray)
            self.state.press(grip["depth"] - out)

        nodes.probe.on_drag("left")(slid)
        nodes.probe.on_drag("left", modifier="shift")(pressed)


def along_line(point: Array, way: Array, ray: Array) -> float:
    """How far along a line the pointer is, as the page shows it.

    Args:
        point: A point of the line, from the eye, shape (3,) [m].
        way: The line's direction, a unit vector, shape (3,) [–].
        ray: From the eye through the pointer, shape (3,), of any length.

    Returns:
        Distance from the point along the way [m]; 0 for a line through the eye.
    """
    across = np.cross(point, way)  # the line and the eye span a plane: the ray in it
    size = float(np.linalg.norm(across) * np.linalg.norm(ray))
    if size == 0.0:
        return 0.0
    across = across / size
    missed = float(np.cross(ray, point) @ across)
    sine = float(np.cross(way, ray) @ across)
    return missed * sine / max(sine**2, STEEP)
