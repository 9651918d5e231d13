"""The solvers' pictures: time and memory against size, residual against time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ttus_opt.benchmark.row import Row
from ttus_opt.benchmark.summary import MIB, solved, was_run, worst_relative
from ttus_opt.report.plots.canvas import look, new_figure, save_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Markers and line styles told apart in greyscale
MARKERS = "os^vDP*X<>hpd"
STYLES = ("-", "--", ":", "-.")

#: Distance of two failures' marks, as a part of their size
SPREAD = 0.04

#: Least residual that is drawn [–]
SMALLEST = 1e-17

#: What a row stands for in a picture; None where it has no such figure
Figured = Callable[[Row], float | None]


def save_pictures(rows: Sequence[Row], folder: Path) -> tuple[str, str, str]:
    """Draw and save all.

    Args:
        rows: All rows of solvers.
        folder: Where to.

    Returns:
        File names: time, memory, residual.
    """
    run = [row for row in rows if was_run(row)]
    # a failure stands at its time limit, and at the size it had taken
    first = "first solve, set-up included [s]"
    figures = {
        "time.png": _against_size(
            run, first, lambda r: r["seconds_first"] if solved(r) else r["time_limit"]
        ),
        "memory.png": _against_size(
            run,
            "largest size of the process [MiB]",
            lambda row: (row["peak_memory_bytes"] or 0) / MIB or None,
        ),
        "residual.png": _residual_against_time(run, first),
    }
    for name, figure in figures.items():
        save_picture(figure, folder / name)
    time, memory, residual = figures
    return time, memory, residual


def _against_size(rows: Sequence[Row], label: str, figured: Figured) -> Figure:
    """One axis per formulation, a curve per solver; failures are unfilled marks."""
    formulations = list(dict.fromkeys(row["formulation"] for row in rows)) or ["–"]
    sizes = sorted({row["voxels"] for row in rows}) or [1]
    with look():
        figure = new_figure(1.0 + 3.4 * len(formulations), 3.6)
        axes = figure.subplots(1, len(formulations), squeeze=False, sharey=True)[0]
        for axis, formulation in zip(axes, formulations, strict=True):
            for index, solver in enumerate(_solvers(rows)):
                own = (formulation, solver)
                _curve(
                    axis,
                    [r for r in rows if (r["formulation"], r["solver"]) == own],
                    _style(index),
                    (1.0 + SPREAD * index, figured),
                )
            axis.set(xscale="log", yscale="log", title=formulation)
            axis.set_xlim(sizes[0] / 1.5, sizes[-1] * 2.0)
            axis.set_xticks(sizes, [f"{size:,}" for size in sizes])
            axis.set_xticks([], minor=True)
            axis.set_xlabel("voxels V")
        axes[0].set_ylabel(label)
        _legend(figure, rows)
    return figure


def _residual_against_time(rows: Sequence[Row], label: str) -> Figure:
    """One mark per answer; unfilled when it failed its check."""
    with look():
        figure = new_figure(6.4, 3.8)
        axis = figure.subplots()
        for index, solver in enumerate(_solvers(rows)):
            for row in rows:
                residual = worst_relative(row)
                if row["solver"] != solver or residual is None:
                    continue
                if not row["seconds_first"]:
                    continue
                at = (row["seconds_first"], max(residual, SMALLEST))
                fill = "full" if solved(row) else "none"
                style = _style(index) | {"linestyle": "none", "fillstyle": fill}
                axis.plot(*at, **style)
                axis.annotate(
                    solver, at, xytext=(5, 3), textcoords="offset points", fontsize=7.5
                )
        axis.set(xscale="log", yscale="log", xlabel=label)
        axis.set_ylabel("relative KKT residual, verified")
        axis.margins(x=0.15, y=0.1)
    return figure


def _solvers(rows: Sequence[Row]) -> list[str]:
    return sorted({row["solver"] for row in rows})


def _style(index: int) -> dict[str, Any]:
    """Ink, marker and line of a solver."""
    grey = f"{0.15 + 0.45 * (index % 4) / 2:.2f}"
    return {
        "color": "#0b4f9c" if index % 2 else grey,
        "marker": MARKERS[index % len(MARKERS)],
        "linestyle": STYLES[index % len(STYLES)],
    }


def _curve(
    axis: Axes, rows: list[Row], style: dict[str, Any], told: tuple[float, Figured]
) -> None:
    """A line through the answers; failures, which share a limit, side by side."""
    aside, figured = told
    told = [
        (row["voxels"], value, solved(row))
        for row in sorted(rows, key=lambda row: row["voxels"])
        if (value := figured(row))
    ]
    answers = [(voxels, value) for voxels, value, passed in told if passed]
    failures = [(aside * voxels, value) for voxels, value, passed in told if not passed]
    axis.plot(*_columns(answers), **style)
    axis.plot(*_columns(failures), **style | {"linestyle": "none", "fillstyle": "none"})


def _columns(points: list[tuple[float, float]]) -> tuple[list[float], list[float]]:
    return [x for x, _ in points], [y for _, y in points]


def _legend(figure: Figure, rows: Sequence[Row]) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], label=solver, **_style(index))
        for index, solver in enumerate(_solvers(rows))
    ]
    if handles:
        figure.legend(handles=handles, loc="outside right upper")
