"""The tab that cuts the patient open: an axial section, or one along the body."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ttus_opt.viewer.colour_map import section_legend
from ttus_opt.viewer.section import Direction, Section, section

if TYPE_CHECKING:
    from ttus_opt.viewer.page import Page

UNITS = {"N": "N", "N cm-2": "N/cm²"}

NONE, AXIAL, ALONG = "none", "axial", "along the body"


class SectionTab:
    """Chooses a section and drags it through the patient.

    Args:
        page: The page.
    """

    def __init__(self, page: Page) -> None:
        self._page, gui, z = page, page.server.gui, page.state.surface.z
        self.shown: list[Section] = []
        self.choice = gui.add_dropdown("section", (NONE, AXIAL, ALONG))
        low, high = np.ceil(1e3 * z[0]), np.floor(1e3 * z[-1])
        middle = np.round(0.5 * (low + high))
        self.height = gui.add_slider(
            "at z [mm]", min=float(low), max=float(high), step=1.0,
            initial_value=float(middle), visible=False,
        )  # fmt: skip
        self.angle = gui.add_slider(
            "at θ [°]", min=0.0, max=179.0, step=1.0, initial_value=90.0, visible=False
        )
        self._legend = gui.add_html("", visible=False)
        for handle in (self.choice, self.height, self.angle):
            page.by_hand(handle, lambda _: self.show())

    def show(self) -> None:
        """Draw what is chosen, soon."""
        choice = self.choice.value
        self.height.visible, self.angle.visible = choice == AXIAL, choice == ALONG
        self._legend.visible = choice != NONE
        self._page.jobs.post("section", self._draw)

    def _draw(self) -> None:
        choice = self.choice.value
        self.shown = []
        if choice != NONE:
            direction: Direction = "axial" if choice == AXIAL else "along"
            at = 1e-3 * self.height.value
            if direction == "along":
                at = float(np.radians(self.angle.value))
            fields = self._page.state.fields
            self.shown = [section(one, direction, at) for one in fields]
            unit = UNITS[self._page.state.fields[0].unit]
            self._legend.content = section_legend(self.shown[0], unit)
        for k, nodes in enumerate(self._page.nodes):
            nodes.show_section(self.shown[k] if self.shown else None)
