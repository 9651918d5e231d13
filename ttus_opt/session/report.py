"""Pictures of a session."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from ttus_opt.core.errors import counted
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.report import plots
from ttus_opt.report.document import Block, Heading, Picture, Table, Text, write_report
from ttus_opt.report.plots.canvas import AFTER, BEFORE, MEASURED, look, new_figure
from ttus_opt.report.tables import error_section
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


def write_reports(
    result: SessionResult, shell: PointShell, path: Callable[[str], Path]
) -> None:
    """Draw the pictures and write ``report.md`` and ``report.html``.

    Args:
        result: Result of the session.
        shell: The probe.
        path: Function that maps the name of a file to its path.

    Raises:
        FileError: A file cannot be written.
    """
    pictures = draw(result, shell)
    for name in ("report.html", *(picture.path for picture in pictures)):
        path(name)
    blocks = [*summary(result), Heading("Pictures"), *pictures]
    write_report(path("report.md").parent, blocks)


def summary(result: SessionResult) -> list[Block]:
    """The report without its pictures."""
    return [
        Heading(result.session.title, 1),
        Text(
            "From the recording to a field that renders contact forces; every step "
            "with what it found. Made by `ttus-opt session`."
        ),
        Heading("What was found"),
        Table(["step", "found"], _steps(result)),
        *error_section(result.comparisons),
    ]


def _steps(result: SessionResult) -> list[list[str]]:
    rows = [
        ["surface", _surface(result)],
        ["registration", _registration(result)],
        ["clock", _clock(result)],
        ["load", _load(result)],
    ]
    for part in result.session.recordings:
        frames = result.recordings[part.name]
        pieces = counted(len(frames.parts), "piece")
        use = "fitted" if part.fitted else "judged"
        rows.append(
            [
                part.name,
                f"{len(frames)} frames from {part.start:g} to {part.end:g} s in "
                f"{pieces}, {use}",
            ]
        )
    after = result.model.after
    worst = (
        "" if after.kkt is None else f", KKT residual {after.kkt.worst_relative:.1e}"
    )
    shape = " × ".join(map(str, result.session.fit.shape))
    known = "; ".join(after.identified)
    found_too = f"; {known}" if known else ""
    rows.extend(["fit", line] for line in result.model.choice.lines)
    rows.append(
        ["fit", f"{after.formulation} on {shape} by {after.solver}{worst}{found_too}"]
    )
    return rows


def _surface(result: SessionResult) -> str:
    surface = result.skin.surface
    cloud = result.skin.cloud
    source = "given" if cloud is None else f"from {len(cloud):,} points"
    return (
        f"{source}, {100 * surface.observed.mean():.0f} % of the radii seen, "
        f"{100 * (surface.z[-1] - surface.z[0]):.0f} cm long"
    )


def _registration(result: SessionResult) -> str:
    tags = result.registration.tags
    if tags is None:
        return "motions as given"
    return (
        f"tracker to scan from {tags.pairs} pairs of tag poses ({tags.solver}): loops "
        f"{tags.loop}, solvers differ by {1e3 * tags.spread:.2f} mm"
    )


def _clock(result: SessionResult) -> str:
    timing = result.timing
    how = "as given"
    if timing.correlation is not None:
        how = f"by {result.session.clock.by}, correlation {timing.correlation:.3f}"
    left_out = counted(result.figures["clock"]["left_out"], "pose")
    return (
        f"forces moved by {timing.offset:.4f} s ({how}); {left_out} without forces "
        "left out"
    )


def _load(result: SessionResult) -> str:
    load = result.load
    return "readings were compensated already" if load is None else str(load)
