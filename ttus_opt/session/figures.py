"""Pictures of a session, one for each step that a picture helps to judge."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
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

#: Half of the stretch of the clocks' picture [s]
HALF_SPAN = 6.0


def draw(
    result: SessionResult, shell: PointShell, path: Callable[[str], Path]
) -> list[Picture]:
    """Draw all pictures and write them.

    Args:
        result: Of the session.
        shell: The probe.
        path: Gives a file's place by its name.

    Returns:
        The pictures, in the order they are shown.
    """
    surface, model = result.skin.surface, result.model
    pictures = []

    def add(name: str, figure: Figure, caption: str) -> None:
        plots.save_picture(figure, path(f"figures/{name}.png"))
        pictures.append(Picture(f"figures/{name}.png", caption))

    figure = plots.surface_picture(surface, result.skin.cloud)
    add("surface", figure, "Surface from the scan, seen and filled")
    if result.timing.first is not None:
        caption = (
            "What both clocks saw, around the liveliest moment: with the offset "
            "found the curves lie on each other"
        )
        add("clock", clock_picture(result.timing), caption)
    for name, recording in result.recordings.items():
        figure = plots.pose_picture(surface, shell, recording, [name])
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
    """Both signals, each over its largest value, on the poses' clock.

    Args:
        timing: With its signals.
    """
    assert timing.first is not None
    assert timing.second is not None
    first, second = timing.first, timing.second
    middle = float(first.time[int(np.argmax(first.values))])
    moved = second.time + timing.offset
    near = np.abs(moved - middle) < HALF_SPAN
    own = np.abs(first.time - middle) < HALF_SPAN
    begin = float(first.time[0])
    scale = first.values[own].max() / max(float(second.values[near].max()), 1e-300)
    with look():
        figure = new_figure(7.2, 2.4)
        axes = figure.subplots()
        axes.plot(
            first.time[own] - begin,
            first.values[own],
            color=MEASURED,
            linewidth=3.0,
            label="poses",
        )
        for offset, style, ink, label in (
            (0.0, (0, (4, 2)), BEFORE, "forces, own clock"),
            (timing.offset, "-", AFTER, f"forces, moved by {timing.offset:.3f} s"),
        ):
            time = second.time + offset
            shown = np.abs(time - middle) < HALF_SPAN
            axes.plot(
                time[shown] - begin,
                scale * second.values[shown],
                color=ink,
                linestyle=style,
                linewidth=0.9,
                label=label,
            )
        axes.set_xlabel("time after the first pose compared [s]")
        axes.set_ylabel("as in the poses")
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)
    return figure
