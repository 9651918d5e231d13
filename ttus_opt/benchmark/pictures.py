"""The benchmark's pictures: time and memory against size, residual against time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from ttus_opt.benchmark.row import Row
from ttus_opt.benchmark.summary import MIB
from ttus_opt.report.plots.canvas import look, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Markers and line styles told apart in greyscale
MARKERS = "os^vDP*X<>hpd"
STYLES = ("-", "--", ":", "-.")

#: Distance of two failures' marks, as a part of their size
SPREAD = 0.04


#: What a row stands for in a picture; None where it has no such figure
Figured = Callable[[Row], float | None]


def time_against_size(rows: Sequence[Row]) -> Figure:
    """Seconds to the first verified answer against the number of voxels.

    Args:
        rows: All rows.

    Returns:
        One axis per formulation; a failure stands at its time limit, unfilled.
    """
    return _against_size(
        rows,
        "first solve, set-up included [s]",
        lambda row: row.seconds_first if row.solved else row.time_limit,
    )


def memory_against_size(rows: Sequence[Row]) -> Figure:
    """Largest size of the process against the number of voxels.

    Args:
        rows: All rows.

    Returns:
        One axis per formulation; a failure stands at what it had taken, unfilled.
    """
    return _against_size(
        rows,
        "largest size of the process [MiB]",
        lambda row: (row.peak_memory_bytes or 0) / MIB or None,
    )


def _against_size(rows: Sequence[Row], label: str, figured: Figured) -> Figure:
    """One axis per formulation, a curve per solver."""
    formulations = list(dict.fromkeys(r.formulation for r in rows if r.was_run))
    with look():
        figure = new_figure(1.0 + 3.4 * max(len(formulations), 1), 3.6)
        axes = figure.subplots(1, max(len(formulations), 1), squeeze=False, sharey=True)
        for axis, formulation in zip(axes[0], formulations, strict=False):
            own = [r for r in rows if r.formulation == formulation and r.was_run]
            for index, solver in enumerate(_solvers(rows)):
                _curve(axis, [r for r in own if r.solver == solver], index, figured)
            axis.set_xscale("log")
            axis.set_yscale("log")
            sizes = sorted({row.voxels for row in rows if row.was_run})
            axis.set_xlim(sizes[0] / 1.5, sizes[-1] * 2.0)
            axis.set_xticks(sizes, [f"{size:,}" for size in sizes])
            axis.set_xticks([], minor=True)
            axis.set_title(formulation)
            axis.set_xlabel("voxels V")
        axes[0][0].set_ylabel(label)
        _legend(figure, rows)
    return figure


def residual_against_time(rows: Sequence[Row]) -> Figure:
    """Verified relative KKT residual against the seconds it took.

    Args:
        rows: All rows.

    Returns:
        A figure with one mark per answer; unfilled when it failed its check.
    """
    with look():
        figure = new_figure(6.4, 3.8)
        axis = figure.subplots()
        for index, solver in enumerate(_solvers(rows)):
            for row in rows:
                residual = row.worst_relative
                if row.solver != solver or residual is None or not row.seconds_first:
                    continue
                axis.plot(
                    row.seconds_first,
                    max(residual, 1e-17),
                    MARKERS[index % len(MARKERS)],
                    color=_ink(index),
                    fillstyle="full" if row.solved else "none",
                )
                axis.annotate(
                    solver,
                    (row.seconds_first, max(residual, 1e-17)),
                    xytext=(5, 3),
                    textcoords="offset points",
                    fontsize=7.5,
                )
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_xlabel("first solve, set-up included [s]")
        axis.set_ylabel("relative KKT residual, verified")
        axis.margins(x=0.15, y=0.1)
    return figure


def _solvers(rows: Sequence[Row]) -> list[str]:
    return sorted({row.solver for row in rows if row.was_run})


def _ink(index: int) -> str:
    return "#0b4f9c" if index % 2 else f"{0.15 + 0.45 * (index % 4) / 2:.2f}"


def _curve(axis: Axes, rows: list[Row], index: int, figured: Figured) -> None:
    told = [
        (row.voxels, value, row.solved)
        for row in sorted(rows, key=lambda row: row.voxels)
        if (value := figured(row))
    ]
    style: dict[str, Any] = {
        "color": _ink(index),
        "marker": MARKERS[index % len(MARKERS)],
    }
    axis.plot(
        [voxels for voxels, _, solved in told if solved],
        [value for _, value, solved in told if solved],
        linestyle=STYLES[index % len(STYLES)],
        **style,
    )
    # failures of one case stand at the same limit: side by side
    axis.plot(
        [voxels * (1.0 + SPREAD * index) for voxels, _, solved in told if not solved],
        [value for _, value, solved in told if not solved],
        linestyle="none",
        fillstyle="none",
        **style,
    )


def _legend(figure: Figure, rows: Sequence[Row]) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D(
            [],
            [],
            color=_ink(index),
            marker=MARKERS[index % len(MARKERS)],
            linestyle=STYLES[index % len(STYLES)],
            label=solver,
        )
        for index, solver in enumerate(_solvers(rows))
    ]
    if handles:
        figure.legend(handles=handles, loc="outside right upper")
