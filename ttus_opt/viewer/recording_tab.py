"""The tab of the recordings: a slider over time that plays, felt against measured."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ttus_opt.viewer.force_plot import add_plot, go_on_click, series
from ttus_opt.viewer.looks import small
from ttus_opt.viewer.recording import Recording

if TYPE_CHECKING:
    from ttus_opt.viewer.page import Page

#: A value below the plot: a chart that holds NaN stays empty [N]
HIDDEN = -1e3


class RecordingTab:
    """Shows recorded poses, one after the other or one by one.

    Attributes:
        has_force: Whether force was measured along them.

    Args:
        page: The page.
        recording: What is shown.
    """

    def __init__(self, page: Page, recording: Recording) -> None:
        self._page, self._recording = page, recording
        self._clock, self._played = recording.clock, 0.0
        self._marked: int | None = None
        gui = page.server.gui
        self.frame = gui.add_slider(
            "frame", min=0, max=max(len(recording) - 1, 1), step=1, initial_value=0
        )
        self.playing = gui.add_checkbox("play", False)
        self.has_force = recording.trajectory.has_wrench
        told = series(page.names, measured=self.has_force, marker=True)
        most = max(float(np.nanmax(one, initial=0.1)) for one in recording.sizes)
        self.plot = add_plot(gui, self._columns(None), told, (0.0, 1.05 * most))
        grey = "Grey is the measured force. " if self.has_force else ""
        gui.add_html(small(f"{grey}A click on the plot goes to that pose."))
        go_on_click(page.server, self.plot, self.frame)
        page.by_hand(self.frame, self._go)
        page.by_hand(self.playing, self._start)
        self._draw_places()

    def play(self, seconds: float) -> None:
        """Go on by some time [s] while playing."""
        if not self.playing.value:
            return
        if self._page.state.source != "recording":  # a hand took over
            self.playing.value = False
            return
        self._played += seconds
        frame = int(np.searchsorted(self._clock, self._played, side="right")) - 1
        if frame != self.frame.value:
            self.frame.value = frame
            self._page.state.show_frame(frame)
        if frame >= len(self._clock) - 1:
            self.playing.value = False

    def draw(self) -> None:
        """Mark the present frame in the plot, while a recorded one is shown."""
        state = self._page.state
        shown = state.frame if state.source == "recording" else None
        if shown != self._marked:  # pages are sent the whole plot
            self._marked = shown
            self.plot.data = self._columns(shown)

    def _go(self, frame: int) -> None:
        self._page.state.show_frame(int(frame))
        self._played = float(self._clock[self._page.state.frame])

    def _start(self, playing: bool) -> None:
        if playing:
            last = self.frame.value >= len(self._clock) - 1
            self.frame.value = 0 if last else self.frame.value
            self._go(self.frame.value)

    def _columns(self, frame: int | None) -> tuple[Any, ...]:
        measured, *rendered = self._recording.sizes
        now = np.full(len(self._clock), HIDDEN)
        if frame is not None:
            now[frame] = rendered[0][frame]
        return (self._clock, *((measured,) if self.has_force else ()), *rendered, now)

    def _draw_places(self) -> None:
        at, shown = self._recording.places, self._recording.trajectory
        if not len(at):
            return
        reference = self._page.state.probe.reference
        starts = shown.position[at] + shown.rotation[at] @ reference
        measured = np.full((len(at), 3), np.nan)
        if shown.force is not None:
            measured = shown.force[at]
        for nodes, rendered in zip(
            self._page.nodes, self._recording.rendered, strict=True
        ):
            nodes.show_recording(starts, np.nan_to_num(measured), rendered[at])
