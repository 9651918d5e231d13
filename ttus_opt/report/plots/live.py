"""Felt and true force of live sessions, one panel for each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from matplotlib.figure import Figure

from ttus_opt.core.arrays import Array
from ttus_opt.report.plots.canvas import AFTER, MEASURED, look, new_figure


class Session(Protocol):
    """What is drawn of a session."""

    @property
    def time(self) -> Array:
        """Shape (n,) [s]."""

    @property
    def felt(self) -> Array:
        """Size of the felt force, shape (n,) [N]."""

    @property
    def true(self) -> Array:
        """Size of the true force at the hand's pose, shape (n,) [N]."""

    @property
    def error(self) -> float:
        """Mean error [N]."""

    @property
    def trial(self) -> Any:
        """Has ``comparator`` and ``round_trip`` [s]."""


def live_picture(sessions: Sequence[Session]) -> Figure:
    """A row for every comparator, a column for every round trip."""
    names = list(dict.fromkeys(s.trial.comparator for s in sessions))
    trips = sorted({s.trial.round_trip for s in sessions})
    with look():
        figure = new_figure(3.6 * len(trips), 1.5 * len(names) + 0.7)
        axes = figure.subplots(
            len(names), len(trips), sharex=True, sharey=True, squeeze=False
        )
        for session in sessions:
            row = names.index(session.trial.comparator)
            ax = axes[row, trips.index(session.trial.round_trip)]
            ax.fill_between(session.time, session.true, color=MEASURED, label="true")
            ax.plot(session.time, session.felt, color=AFTER, lw=1.0, label="felt")
            trip = 1e3 * session.trial.round_trip
            ax.set_title(
                f"{session.trial.comparator}, {trip:.0f} ms: {session.error:.2f} N"
            )
        for ax in axes[-1]:
            ax.set_xlabel("time [s]")
        for ax in axes[:, 0]:
            ax.set_ylabel("force [N]")
        drawn = axes[0, 0].get_legend_handles_labels()
        figure.legend(*drawn, loc="outside lower center", ncols=2)
    return figure
