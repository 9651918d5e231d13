"""The solvers' pictures: time and memory against size, residual against time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import filterfalse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ttus_opt.benchmark.row import Row
from ttus_opt.benchmark.summary import MIB, solved, was_run, worst_relative
from ttus_opt.report.plots.canvas import look, new_figure, save_picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Inks, markers and line styles, told apart in greyscale
INKS, MARKERS, STYLES = (
    ("0.15", "#0b4f9c", "0.6"),
    "os^vDP*X<>hpd",
    ("-", "--", ":", "-."),
)

#: Distance of two failures' marks, which share a limit, as a part of their size
SPREAD = 0.04

#: What a row stands for in a picture; NaN where it has no such figure
Figured = Callable[[Row], float]


def save_pictures(rows: Sequence[Row], folder: Path) -> dict[str, str]:
    """Draw and save what there is to show.

    Args:
        rows: All rows of solvers.
        folder: Where to.

    Returns:
        Caption by file name.
    """
    rows = sorted(filter(was_run, rows), key=lambda row: (row["voxels"], row["solver"]))
    first = "first solve, set-up included [s]"
    size = "largest size of the process [MiB]"
    captions = {}
    with look():
        if rows:
            figure = _against_size(
                rows,
                first,
                lambda r: r["seconds_first"] if solved(r) else r["time_limit"],
            )
            captions["time.png"] = "time against voxels"
            save_picture(figure, folder / "time.png")
        if any(row["peak_memory_bytes"] for row in rows):
            figure = _against_size(
                rows, size, lambda r: (r["peak_memory_bytes"] or math.nan) / MIB
            )
            captions["memory.png"] = "memory against voxels"
            save_picture(figure, folder / "memory.png")
        if any(row["kkt"] for row in rows):
            captions["residual.png"] = "residual against time"
            save_picture(_residual_against_time(rows, first), folder / "residual.png")
    return captions


def _against_size(rows: Sequence[Row], label: str, figured: Figured) -> Figure:
    """One axis per formulation, a curve per solver; failures are unfilled marks."""
    formulations = list(dict.fromkeys(row["formulation"] for row in rows))
    sizes = sorted({row["voxels"] for row in rows})
    figure = new_figure(1.0 + 3.4 * len(formulations), 3.6)
    axes = figure.subplots(1, len(formulations), squeeze=False, sharey=True)[0]
    for axis, formulation in zip(axes, formulations, strict=True):
        for index, (solver, style) in enumerate(_styles(rows).items()):
            place = (formulation, solver)
            own = [r for r in rows if (r["formulation"], r["solver"]) == place]
            answers = _points(filter(solved, own), figured, 1.0)
            failed = _points(filterfalse(solved, own), figured, 1.0 + SPREAD * index)
            axis.plot(*answers, label=solver, **style)
            axis.plot(*failed, **style | {"linestyle": "none", "fillstyle": "none"})
        axis.set(xscale="log", yscale="log", title=formulation, xlabel="voxels V")
        axis.set_xlim(sizes[0] / 1.5, sizes[-1] * 2.0)
        axis.set_xticks(sizes, [f"{size:,}" for size in sizes])
        axis.set_xticks([], minor=True)
    axes[0].set_ylabel(label)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right upper")
    return figure


def _points(
    rows: Iterable[Row], figured: Figured, aside: float
) -> tuple[list[float], list[float]]:
    """Sizes and figures, where there are any."""
    told = {aside * r["voxels"]: y for r in rows if not math.isnan(y := figured(r))}
    return list(told), list(told.values())


def _residual_against_time(rows: Sequence[Row], label: str) -> Figure:
    """One mark per answer; unfilled when it failed its check."""
    figure = new_figure(6.4, 3.8)
    axis = figure.subplots()
    styles = _styles(rows)
    for row in rows:
        residual = worst_relative(row)
        if residual is None:
            continue
        at = (row["seconds_first"], max(residual, 1e-17))
        fill = {"linestyle": "none", "fillstyle": "full" if solved(row) else "none"}
        axis.plot(*at, **styles[row["solver"]] | fill)
        beside: dict[str, Any] = {"xytext": (5, 3), "textcoords": "offset points"}
        axis.annotate(row["solver"], at, fontsize=7.5, **beside)
    axis.set(xscale="log", yscale="log", xlabel=label)
    axis.set_ylabel("relative KKT residual, verified")
    axis.margins(x=0.15, y=0.1)
    return figure


def _styles(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Ink, marker and line of every solver."""
    return {
        solver: {
            "color": INKS[n % len(INKS)],
            "marker": MARKERS[n % len(MARKERS)],
            "linestyle": STYLES[n % len(STYLES)],
        }
        for n, solver in enumerate(sorted({row["solver"] for row in rows}))
    }
