"""Streams of poses and wrenches over time, with their gaps and jumps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ttus_opt.core.arrays import Array
from ttus_opt.probe.raw_recording import RawRecording
from ttus_opt.probe.repair import gaps
from ttus_opt.report.plots.canvas import look, new_figure

#: Most panels of a picture
MOST_PANELS = 12

#: Lines of the components, told apart in greyscale by their dashes
COMPONENTS: tuple[dict[str, Any], ...] = (
    {"color": "#0b4f9c", "linestyle": "-"},
    {"color": "#b4532a", "linestyle": (0, (5, 1.5))},
    {"color": "0.35", "linestyle": (0, (1.5, 1))},
)


def stream_picture(streams: Mapping[str, RawRecording]) -> Figure:
    """One panel for the positions and one for the forces of each stream.

    Args:
        streams: By their titles, one or more.
    """
    panels = []
    for title, raw in streams.items():
        for values, what in ((raw.position, "position [m]"), (raw.force, "force [N]")):
            if values is not None and len(values):
                panels.append((title, raw, values, what))
    panels = panels[:MOST_PANELS]
    with look():
        figure = new_figure(7.2, 0.4 + 1.7 * max(len(panels), 1))
        axes = figure.subplots(max(len(panels), 1), 1, squeeze=False)[:, 0]
        for ax, (title, raw, values, what) in zip(axes, panels, strict=True):
            _draw(ax, raw, values, what)
            ax.set_title(title)
        axes[-1].set_xlabel("time after the first row [s]")
    return figure


def _draw(axes: Any, raw: RawRecording, values: Array, what: str) -> None:
    finite = np.isfinite(raw.time) & np.isfinite(values).all(axis=1)
    time, known = raw.time[finite], values[finite]
    if not len(time):
        axes.text(0.5, 0.5, "no numbers", transform=axes.transAxes, ha="center")
        return
    time = time - time[0]
    after = np.flatnonzero(gaps(raw.select(finite)))
    cuts = np.flatnonzero(np.diff(raw.segment[finite]) != 0) + 1
    breaks = np.union1d(after, cuts)
    clock = np.insert(time, breaks, np.nan)
    for i, (name, style) in enumerate(zip("xyz", COMPONENTS, strict=True)):
        line = np.insert(known[:, i], breaks, np.nan)
        axes.plot(clock, line, label=name, linewidth=1.0, **style)
    for row in breaks:
        axes.axvspan(time[row - 1], time[row], color="0.9", linewidth=0)
    axes.set_ylabel(what)
    axes.margins(x=0.01)
    axes.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
