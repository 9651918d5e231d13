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
    surface = result.skin.surface
    figures = {
        "surface": plots.surface_picture(surface, result.skin.cloud),
    }
    captions = {"surface": "Surface from the scan, seen and filled"}
    if result.timing.first is not None:
        figures["clock"] = clock_picture(result.timing)
        captions["clock"] = (
            "What both clocks saw, around the liveliest moment: with the offset "
            "found the curves lie on each other"
        )
    names = list(result.recordings)
    for name in names:
        figures[f"poses_{name}"] = plots.pose_picture(
            surface, shell, result.recordings[name], [name]
        )
        captions[f"poses_{name}"] = f"Probe and contact forces on the patient: {name}"
    for case in result.comparisons:
        if case.seen:
            continue
        pair = {"Laplace alone": case.before, "fitted": case.after}
        figures[f"force_{case.recording}"] = plots.force_over_time(
            pair, f"{case.recording}: motion the field has not seen"
        )
        captions[f"force_{case.recording}"] = (
            f"Measured and rendered force, {case.recording}, which was not fitted"
        )
    model = result.model
    figures["potential"] = plots.potential_slices(model.before.field, model.after.field)
    captions["potential"] = "Potential before and after fitting, and the difference"
    pictures = []
    for name, figure in figures.items():
        plots.save_picture(figure, path(f"figures/{name}.png"))
        pictures.append(Picture(f"figures/{name}.png", captions[name]))
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
