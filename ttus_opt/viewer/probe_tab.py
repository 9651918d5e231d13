"""The tab that moves the probe: by fields, buttons and keys, and running plots."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.viewer.force_plot import add_plot, series
from ttus_opt.viewer.looks import small
from ttus_opt.viewer.state import LEAST, MOST

if TYPE_CHECKING:
    from ttus_opt.viewer.page import Page

#: A step of the buttons and keys [m], [deg]
STEP, TURN = 1e-3, 1.0

#: What the running plots show [s], and how often they take a point [s]
SHOWN, EVERY = 10.0, 0.05

#: What they show: a plot each
QUANTITIES = "force [N]", "torque [mN m]"

#: Ways of the buttons and keys: name, keys back and forth; around, along, deeper
WAYS = {
    "around": ("J", "L", (1, 0, 0)),
    "along": ("K", "I", (0, 1, 0)),
    "deeper": ("U", "O", (0, 0, 1)),
}

#: Turns, with shift: about the skin's normal, about the ways around and along the body
TURNS = {
    "tilt around": ("J", "L", (0, 0, -1)),
    "tilt along": ("K", "I", (0, 1, 0)),
    "turn": ("U", "O", (1, 0, 0)),
}

HELP = (
    "Drag the probe over the skin, with <i>shift</i> into it, or click on the skin. "
    "Keys: J L around, I K along, U O lift and press by 1 mm; with <i>shift</i> they "
    "tilt and turn by 1°."
)


class ProbeTab:
    """Inputs that move the hand's pose, and show where it is.

    Args:
        page: The page.
        tab: Where they are.
    """

    def __init__(self, page: Page, tab: Any) -> None:
        self._page, self._tab, gui = page, tab, page.server.gui
        self._points: deque[tuple[float, list[float]]] = deque()
        self._depth = gui.add_slider(
            "depth [mm]", min=1e3 * LEAST, max=1e3 * MOST, step=0.1, initial_value=0.0
        )
        theta, z = page.state.place
        self._theta = gui.add_number("θ [°]", float(np.degrees(theta)), step=1.0)
        self._z = gui.add_number("z [mm]", 1e3 * z, step=1.0)
        self._angles = gui.add_vector3(
            "turn, tilts [°]", (0.0, 0.0, 0.0), step=1.0,
            hint="about the skin's normal, about the ways around and along the body",
        )  # fmt: skip
        with gui.add_folder("steps of 1 mm and 1°", expand_by_default=False):
            for name, (back, forth, way) in (WAYS | TURNS).items():
                self._add_step(name, (back, forth), way)
        self.free = gui.add_checkbox(
            "handle", False, hint="arrows and rings at the probe, for any pose"
        )
        gui.add_html(small(HELP))
        self.plots: tuple[Any, ...] = ()
        self._listen()
        self.show()

    def show(self) -> None:
        """Write the hand's pose into the fields."""
        state = self._page.state
        theta, z = state.place
        self._depth.value = round(1e3 * state.depth, 1)
        self._theta.value = round(float(np.degrees(theta)), 2)
        self._z.value = round(1e3 * z, 2)
        self._angles.value = tuple(round(float(a), 1) + 0.0 for a in state.angles)

    def add_point(self, time: float) -> None:
        """Take what is felt now into the running plots, every `EVERY`."""
        points = self._points
        if points and time - points[-1][0] < EVERY:
            return
        wrenches = [touch.wrench for touch in self._page.state.touches]
        felt = [w.force for w in wrenches] + [1e3 * w.torque for w in wrenches]
        sizes = [float(np.linalg.norm(one)) for one in felt]
        if not points:
            points.append((time - SHOWN, sizes))
        elif time - points[-1][0] > 2.0 * EVERY:  # it rested
            points.append((time - EVERY, points[-1][1]))
        points.append((time, sizes))
        while len(points) > 2 and points[1][0] < time - SHOWN:
            points.popleft()

    def draw(self) -> None:
        """Draw the running plots, once something has moved."""
        if len(self._points) < 2:
            return
        if not self.plots:
            gui, told = self._page.server.gui, series(self._page.names)
            with self._tab:
                self.plots = tuple(
                    add_plot(gui, columns, told, quantity=quantity)
                    for columns, quantity in zip(
                        self.columns(), QUANTITIES, strict=True
                    )
                )
        for plot, columns in zip(self.plots, self.columns(), strict=True):
            plot.data = columns

    def columns(self) -> tuple[tuple[Array, ...], ...]:
        """Of every plot: time [s] and every field's, force [N] and torque [mN m]."""
        fields = len(self._page.names)
        times, sizes = zip(*self._points, strict=True)
        time = np.maximum(np.array(times) - times[-1], -SHOWN)
        felt = np.array(sizes).T
        return (time, *felt[:fields]), (time, *felt[fields:])

    def _step(self, way: tuple[int, int, int], sign: int) -> None:
        around, along, deeper = (STEP * sign * w for w in way)
        self._page.state.move(around=around, along=along, deeper=deeper)

    def _turn(self, way: tuple[int, int, int], sign: int) -> None:
        state = self._page.state
        state.tilt(state.angles + TURN * sign * np.array(way, dtype=np.float64))

    def _add_step(
        self, name: str, keys: tuple[str, str], way: tuple[int, int, int]
    ) -> None:
        """Two buttons and two keys for a way back and forth."""
        gui: Any = self._page.server.gui
        act, unit = (self._step, "1 mm") if name in WAYS else (self._turn, "1°")
        labels = f"− {unit}", f"+ {unit}"
        group = gui.add_button_group(name, labels)

        async def clicked(event: Any) -> None:
            act(way, 1 if event.target.value == labels[1] else -1)

        group.on_click(clicked)
        modifier = None if name in WAYS else "shift"
        for key, sign in zip(keys, (-1, 1), strict=True):
            command = gui.add_command(
                f"probe: {name} {'−+'[sign > 0]} {unit}", hotkey=key, modifier=modifier
            )

            async def pressed(_: Any, sign: int = sign) -> None:
                act(way, sign)

            command.on_trigger(pressed)

    def _listen(self) -> None:
        page, state = self._page, self._page.state

        def slide(_: float) -> None:
            state.slide(float(np.radians(self._theta.value)), 1e-3 * self._z.value)

        page.by_hand(self._depth, lambda value: state.press(1e-3 * value))
        page.by_hand(self._theta, slide)
        page.by_hand(self._z, slide)
        page.by_hand(self._angles, lambda value: state.tilt(np.array(value)))
