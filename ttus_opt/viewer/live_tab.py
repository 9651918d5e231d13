"""The tab of a live session: its state, the link, felt against measured, the button."""

from __future__ import annotations

import math
from dataclasses import replace
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from ttus_opt.live.operator import LiveState
from ttus_opt.viewer.force_plot import add_plot, series
from ttus_opt.viewer.live_session import LiveSession
from ttus_opt.viewer.looks import small
from ttus_opt.viewer.readout import TABLE

if TYPE_CHECKING:
    from ttus_opt.viewer.page import Page

#: Longest round trip [ms], most loss [%] and range of a prior's factor of the inputs
LONGEST, MOST, PRIORS = 1000, 20, (0.5, 2.0)

#: What the plot shows [s]
SHOWN = 10.0

#: Speed below which a page says that it is slow [–]
SLOW = 0.8

#: Colours of the states
COLOURS = {"NORMAL": "#1c7a5c", "HOLD": "#b45309", "STOP": "#b91c1c"}

NOTICE = "Not a medical device."


class LiveTab:
    """Inputs and figures of a session.

    Args:
        page: The page.
        session: What is shown.
    """

    def __init__(self, page: Page, session: LiveSession) -> None:
        self._page, self._session = page, session
        gui, trial = page.server.gui, session.trial
        # above what comes and goes: the button stays where it is
        self.stop = gui.add_button("STOP", color="red")
        self.rearm = gui.add_button("re-arm, at zero contact")
        self._state = gui.add_html("")
        self.delay = gui.add_slider(
            "round trip [ms]", min=0, max=LONGEST, step=10,
            initial_value=round(1e3 * trial.round_trip),
        )  # fmt: skip
        self.loss = gui.add_slider(
            "loss [%]", min=0, max=MOST, step=1, initial_value=round(100 * trial.loss)
        )
        self.presses = gui.add_checkbox(
            "the simulated hand presses", True, hint="a drag of the probe takes over"
        )
        self.plot = add_plot(gui, self._columns(), series(["felt"], measured=True))
        gui.add_html(
            small(
                "Felt and measured force at the pose of the measurement, whatever the "
                "delay. The patient is simulated; felt is what the operator's model "
                "gives."
            )
        )
        self.prior = gui.add_slider(
            "prior too stiff by", min=PRIORS[0], max=PRIORS[1], step=0.1,
            initial_value=trial.prior,
        )  # fmt: skip
        self.again = gui.add_button("begin again with this prior")
        self._listen()
        self.write()

    def write(self) -> None:
        """Write numbers and plot; a few times a second."""
        self._state.content = numbers(self._session.view(), self._session.speed)
        self.plot.data = self._columns()

    def _listen(self) -> None:
        session, page = self._session, self._page
        page.by_hand(self.delay, lambda ms: session.worsen(round_trip=1e-3 * ms))
        page.by_hand(self.loss, lambda share: session.worsen(loss=0.01 * share))
        page.by_hand(self.presses, self._release)
        page.by_click(self.stop, session.stop)
        page.by_click(self.rearm, session.rearm)
        page.by_click(self.again, self._restart)

    def _restart(self) -> None:
        trial = replace(self._session.trial, prior=float(self.prior.value))
        self._session.restart(trial)

    def _release(self, presses: bool) -> None:
        if presses:
            state, hand = self._page.state, self._session.hand
            with state.lock:
                hand.lead = None
                state.follow(hand.rotation, hand.position)

    def _columns(self) -> tuple[Any, ...]:
        samples = list(self._session.samples)
        if len(samples) < 2:
            return tuple(np.zeros(2) for _ in range(3))
        time, measured, felt = np.array(samples).T
        kept = time > time[-1] - SHOWN
        return time[kept] - time[-1], measured[kept], felt[kept]


def numbers(view: LiveState, speed: float = 1.0) -> str:
    """State and figures of a session as HTML.

    Args:
        view: The present moment.
        speed: Of the session's time over that on the wall [–].
    """
    colour, sample = COLOURS[view.state], view.measured
    cause = f": {escape(view.cause)}" if view.cause else ""
    rows = [("felt now", f"{np.linalg.norm(view.force):.2f} N")]
    if math.isfinite(view.force_std):
        rows[0] = ("felt now", f"{rows[0][1]} ± {view.force_std:.2f}")
    if sample is not None and view.felt_there is not None:
        measured = float(np.linalg.norm(sample.wrench[:3]))
        there = float(np.linalg.norm(view.felt_there))
        rows.append(("measured, felt there", f"{measured:.2f} N, {there:.2f} N"))
    age = f"{view.model_age:.1f} s" if math.isfinite(view.model_age) else "the prior"
    trip = f"{1e3 * view.round_trip:.0f} ms" if math.isfinite(view.round_trip) else "–"
    rows += [
        ("round trip, loss", f"{trip}, {100 * view.loss:.0f} %"),
        ("model's age, samples", f"{age}, {view.folded}"),
        (
            "sent",
            f"{view.packets_per_second:.0f} packets/s, "
            f"{1e-3 * view.bits_per_second:.0f} kbit/s",
        ),
    ]
    if speed < SLOW:
        rows.append(("a busy machine", f"{100 * speed:.0f} % of real time"))
    if view.limited_by:
        rows.append(("limited by", escape(view.limited_by)))
    cells = "".join(
        f'<tr><td style="color:#777">{name}</td>'
        f'<td style="text-align:right">{value}</td></tr>'
        for name, value in rows
    )
    return (
        f'<div style="padding:2px 12px 8px"><div style="background:{colour};'
        'color:white;border-radius:6px;padding:4px 8px;font-weight:600">'
        f"{view.state}{cause}</div>"
        f"{TABLE}{cells}</table>"
        f'<div style="color:#777;font-size:12px">{NOTICE}</div></div>'
    )
