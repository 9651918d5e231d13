"""A page of a simulated live session: ``ttus-opt live page``."""

from __future__ import annotations

import time

from ttus_opt.core.closing import Closing
from ttus_opt.core.optional import load
from ttus_opt.live.subject import Subject
from ttus_opt.live.trial import Trial
from ttus_opt.probe.mesh import TriangleMesh
from ttus_opt.viewer.guarded_server import PORT
from ttus_opt.viewer.live_session import LiveSession
from ttus_opt.viewer.live_tab import LiveTab
from ttus_opt.viewer.state import ViewState
from ttus_opt.viewer.viewer import Viewer

#: Time between updates of numbers, and of the field that colours the skin [s]
WRITING, COLOURING = 0.2, 3.0

#: What the page begins with
FIRST = Trial(round_trip=0.2, prior=1.6)


class LivePage(Closing):
    """A page with a session that runs, open until `close`.

    Attributes:
        session: The session.
        viewer: The page.
        tab: Its part about the session.

    Args:
        trial: What is simulated at first.
        subject: Who is examined; by default the example.
        mesh: The probe's own mesh, probe frame; None for the hull of its points.
        port: Where to serve; the next free one if it is taken.

    Raises:
        MissingPackageError: viser is not installed.
    """

    def __init__(
        self,
        trial: Trial = FIRST,
        subject: Subject | None = None,
        *,
        mesh: TriangleMesh | None = None,
        port: int = PORT,
    ) -> None:
        load("viser", "viewer")  # before anything that takes long
        self.session = LiveSession(trial, subject)
        who = self.session.subject
        state = ViewState([self.session.field], who.shell, usual=who.hold)
        self._follow(state)
        self.viewer = Viewer(state, ["felt"], mesh=mesh, port=port)
        page = self.viewer.page
        with page.tabs.add_tab("Live"):
            self.tab = LiveTab(page, self.session)
        self._written = self._coloured = time.monotonic()
        self._folded = 0
        self.session.start(self._show)

    def close(self) -> None:
        """End session and page."""
        self.session.close()
        self.viewer.close()

    def _show(self) -> None:
        """After a batch of frames: probe, numbers, field."""
        state, now = self.viewer.state, time.monotonic()
        with state.lock:  # a visitor who takes over now would be overruled
            leads = state.source == "hand"
            if leads and self.session.hand.lead is None:
                self.tab.presses.value = False
            if leads or not self.tab.presses.value:
                self._lead(state)
            else:
                self._follow(state)
        if now - self._written >= WRITING:
            self._written = now
            self.tab.write()
        if now - self._coloured >= COLOURING and self.session.learned != self._folded:
            self._coloured, self._folded = now, self.session.learned
            self.viewer.update(self.session.field)

    def _follow(self, state: ViewState) -> None:
        """Show the simulated hand."""
        hand = self.session.hand
        state.follow(hand.rotation, hand.position)

    def _lead(self, state: ViewState) -> None:
        """Lead the simulated hand to where the page's probe is."""
        if state.touches:
            touch = state.touches[0]
            self.session.hand.lead = touch.rotation, touch.position
