"""Pictures of a session."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from ttus_opt.probe.point_shell import PointShell
from ttus_opt.report import plots
from ttus_opt.report.document import Picture
from ttus_opt.report.plots.canvas import AFTER, BEFORE, MEASURED, look, new_figure
from ttus_opt.session.readings import Timing

if TYPE_CHECKING:
    from ttus_opt.session.pipeline import SessionResult

#: Half the time span of the clocks' picture [s]
HALF_SPAN = 6.0


def draw(result: SessionResult, shell: PointShell) -> list[Picture]:
    """All pictures, in the order of the report."""
    surface, model = result.skin.surface, result.model
    pictures = []

    def add(name: str, figure: Figure, caption: str) -> None:
        pictures.append(Picture(f"figures/{name}.png", caption, figure))

    figure = plots.surface_picture(surface, result.skin.cloud)
    add("surface", figure, "Surface from the scan, seen and filled")
    if result.timing.first is not None:
        caption = (
            "What both clocks saw, around the liveliest moment: with the offset "
            "found the curves lie on each other"
        )
        add("clock", clock_picture(result.timing), caption)
    for name, recording in result.recordings.items():
        pieces = replace(recording, segment=np.zeros(len(recording), np.int64))
        figure = plots.pose_picture(surface, shell, pieces, [name])
        add(f"poses_{name}", figure, f"Probe and contact forces on the patient: {name}")
    for case in result.comparisons:
        if not case.seen:
            name = case.recording
            pair = {"Laplace alone": case.before, "fitted": case.after}
            title = f"{name}: motion the field has not seen"
            caption = f"Measured and rendered force, {name}, which was not fitted"
            add(f"force_{name}", plots.force_over_time(pair, title), caption)
    figure = plots.potential_slices(model.before.field, model.after.field)
    add("potential", figure, "Potential before and after fitting, and the difference")
    return pictures


def clock_picture(timing: Timing) -> Figure:
    """Both signals of a timing, each over its largest value, on the poses' clock."""
    first, second = timing.first, timing.second
    assert first is not None
    assert second is not None
    middle = float(first.time[int(np.argmax(first.values))])
    moved = second.time + timing.offset
    near = np.abs(moved - middle) < HALF_SPAN
    shown = np.abs(first.time - middle) < HALF_SPAN
    begin = float(first.time[0])
    most = max(float(first.values[shown].max()), 1e-300)
    other = max(float(second.values[near].max()), 1e-300)
    later = f"forces, moved by {timing.offset:.3f} s"
    with look():
        figure = new_figure(7.2, 2.4)
        axes = figure.subplots()
        for time, values, style, ink, width, label in (
            (first.time, first.values / most, "-", MEASURED, 3.0, "poses"),
            (second.time, second.values / other, (0, (4, 2)), BEFORE, 0.9, "forces"),
            (moved, second.values / other, "-", AFTER, 0.9, later),
        ):
            at = np.abs(time - middle) < HALF_SPAN
            (line,) = axes.plot(time[at] - begin, values[at], linestyle=style)
            line.set(color=ink, linewidth=width, label=label)
        axes.set_xlabel("time after the first pose compared [s]")
        axes.set_ylabel("share of the largest [–]")
        axes.set_ylim(bottom=0.0)
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)
    return figure
