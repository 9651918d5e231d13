"""The solvers' pictures: time and memory against size, residual against time.

Performance profiles tell how often a solver is within a factor of the fastest: ρ_s(τ)
is the fraction of problems p that solver s solves with t_{p,s} ≤ τ min_s' t_{p,s'} (E.
D. Dolan and J. J. Moré, Benchmarking optimization software with performance profiles,
Mathematical Programming 91, 2002, eq. 2.1). ρ_s(1) is how often it is the fastest, ρ_s
for large τ how many problems it solves. Refused and failed problems count as not
solved; problems that no solver solved are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import cycle, filterfalse
from typing import TYPE_CHECKING, Any

from ttus_opt.benchmark.row import Row
from ttus_opt.benchmark.summary import MIB, group, solved, was_run, worst_relative
from ttus_opt.report.document import Picture, Table
from ttus_opt.report.plots.canvas import look, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


#: Colours, markers and line styles, distinct in greyscale
INKS, MARKERS, STYLES = (
    ("0.15", "#0b4f9c", "0.6"),
    "os^vDP*X<>hpd",
    ("-", "--", ":", "-."),
)

#: Relative offset between the marks of failures, which share a time limit
SPREAD = 0.04

#: The plotted value of a row; NaN without one
Figured = Callable[[Row], float]

#: Colour, marker and line by solver
Inks = Mapping[str, Mapping[str, Any]]


def pictures(rows: Sequence[Row]) -> list[Picture]:
    """Up to three pictures per formulation."""
    rows = sorted(filter(was_run, rows), key=lambda row: (row["voxels"], row["solver"]))
    inks = solver_styles(row["solver"] for row in rows)
    return [
        Picture(f"{name}-{formulation}.png", f"{formulation}: {caption}", figure)
        for formulation in dict.fromkeys(row["formulation"] for row in rows)
        for name, caption, figure in _pictures(
            [row for row in rows if row["formulation"] == formulation], inks
        )
    ]


def _pictures(rows: Sequence[Row], inks: Inks) -> Iterator[tuple[str, str, Figure]]:
    """Name, caption and figure of each picture of one formulation."""
    first = "first solve, set-up included [s]"

    def taken(row: Row) -> float:
        return float(row["seconds_first"] if solved(row) else row["time_limit"])

    def size(row: Row) -> float:
        return float(row["peak_memory_bytes"] or math.nan) / MIB

    with look():
        drawn = _against_size(rows, inks, first, taken)
        yield "time", "time against voxels; unfilled: not solved, at time limit", drawn
        if any(row["peak_memory_bytes"] for row in rows):
            drawn = _against_size(rows, inks, "largest size of the process [MiB]", size)
            yield "memory", "memory against voxels; unfilled: not solved", drawn
        if any(worst_relative(row) is not None for row in rows):
            drawn = _residual_against_time(rows, inks, first)
            yield "residual", "residual against time; unfilled: not solved", drawn


def _against_size(
    rows: Sequence[Row], inks: Inks, label: str, figured: Figured
) -> Figure:
    """A curve per solver; failures are unfilled marks."""
    sizes = sorted({row["voxels"] for row in rows})
    figure = new_figure(5.6, 3.6)
    axis = figure.subplots()
    shown = sorted({row["solver"] for row in rows})
    for index, solver in enumerate(shown):
        runs, style = [r for r in rows if r["solver"] == solver], inks[solver]
        answers = _points(filter(solved, runs), figured, 1.0)
        failed = _points(filterfalse(solved, runs), figured, 1.0 + SPREAD * index)
        axis.plot(*answers, label=solver, **style)
        axis.plot(*failed, **{**style, "linestyle": "none", "fillstyle": "none"})
    axis.set(xscale="log", yscale="log", title=rows[0]["formulation"])
    axis.set(xlabel="voxels V [–]", ylabel=label)
    axis.set_xlim(sizes[0] / 1.5, sizes[-1] * 2.0)
    axis.set_xticks(sizes, [f"{size:,}" for size in sizes])
    axis.set_xticks([], minor=True)
    axis.plot([], [], "o", color="0.4", fillstyle="none", label="unfilled: not solved")
    figure.legend(loc="outside right upper")
    return figure


def _points(
    rows: Iterable[Row], figured: Figured, aside: float
) -> tuple[list[float], list[float]]:
    """Sizes and values of the rows that have both."""
    points = {aside * r["voxels"]: y for r in rows if not math.isnan(y := figured(r))}
    return list(points), list(points.values())


def _residual_against_time(rows: Sequence[Row], inks: Inks, label: str) -> Figure:
    """One mark per answer, unfilled if it is not verified."""
    figure = new_figure(6.4, 3.8)
    axis = figure.subplots()
    for row in rows:
        residual = worst_relative(row)
        if residual is None:
            continue
        # an ended run has the residual of its last reported answer
        seconds = row["seconds_first"] or row["time_limit"]
        at = (seconds, max(residual, 1e-17))
        fill = {"linestyle": "none", "fillstyle": "full" if solved(row) else "none"}
        axis.plot(*at, **{**inks[row["solver"]], **fill})
        beside: dict[str, Any] = {"xytext": (5, 3), "textcoords": "offset points"}
        axis.annotate(row["solver"], at, fontsize=7.5, **beside)
    axis.set(xscale="log", yscale="log", xlabel=label, title=rows[0]["formulation"])
    axis.set_ylabel("relative KKT residual, verified [–]")
    axis.margins(x=0.15, y=0.1)
    return figure


def solver_styles(names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Colour, marker and line of every solver, by name."""
    every = zip(cycle(INKS), cycle(MARKERS), cycle(STYLES), strict=True)
    return {
        solver: {"color": ink, "marker": marker, "linestyle": style}
        for solver, (ink, marker, style) in zip(sorted(set(names)), every, strict=False)
    }


#: Factors of the table [–]
FACTORS = (1.0, 2.0, 5.0, 10.0, 100.0)

LEGEND = (
    "Share of the {n} problems that a solver solves within a factor τ of the fastest, "
    "set-up included (Dolan & Moré 2002): τ = 1 is how often it is the fastest, *ever* "
    "how much it solves within the time limit. What a solver cannot take or fails on "
    "counts as not solved."
)


def ratios(rows: Sequence[Row]) -> dict[str, list[float]]:
    """Time over the fastest solver's, r_{p,s} by solver, for every solved problem [–].

    Infinite if a solver has no verified answer; all solvers are included.
    """
    taken: dict[tuple[str, str], dict[str, float]] = {}
    for row in rows:
        if solved(row):
            taken.setdefault(group(row), {})[row["solver"]] = row["seconds_first"]
    return {
        solver: [
            own.get(solver, math.inf) / min(own.values()) for own in taken.values()
        ]
        for solver in dict.fromkeys(row["solver"] for row in rows)
    }


def share(of_solver: Sequence[float], factor: float) -> float:
    """ρ_s(τ) of one solver's ratios; NaN without problems [–].

    >>> share([1.0, 3.0, math.inf], 3.0)
    0.6666666666666666
    """
    if not of_solver:
        return math.nan
    return sum(r <= factor for r in of_solver) / len(of_solver)


def ranked(rows: Sequence[Row]) -> dict[str, list[float]]:
    """`ratios` of solvers with any answer, sorted by ρ_s(2)."""
    times = {
        s: r for s, r in ratios(rows).items() if min(r, default=math.inf) < math.inf
    }
    order = sorted(
        times, key=lambda s: (-share(times[s], 2.0), -share(times[s], 1e300), s)
    )
    return {solver: times[solver] for solver in order}


def profile_table(by_solver: Mapping[str, Sequence[float]]) -> Table:
    """ρ_s at `FACTORS` as a table; from `ranked`."""
    body = [
        [solver, *(f"{share(of_solver, f):.0%}" for f in (*FACTORS, 1e300))]
        for solver, of_solver in by_solver.items()
    ]
    return Table(["solver", *(f"τ = {f:g}" for f in FACTORS), "ever"], body)


def profile_picture(by_solver: Mapping[str, Sequence[float]]) -> Figure:
    """ρ_s(τ) as steps over a logarithmic τ; from `ranked`."""
    finite = [r for of_solver in by_solver.values() for r in of_solver if r < math.inf]
    end = 1.5 * max(finite)
    with look():
        figure = new_figure(7.0, 4.0)
        axis = figure.subplots()
        styles = solver_styles(by_solver)
        for solver in by_solver:
            of_solver = sorted(r for r in by_solver[solver] if r < math.inf)
            steps = [1.0, *of_solver, end]
            heights = [share(by_solver[solver], r) for r in steps]
            axis.step(
                steps, heights, where="post", label=solver, markevery=(0.02, 0.15),
                **styles[solver],
            )  # fmt: skip
        axis.set(xscale="log", xlabel="factor τ of the fastest [–]", xlim=(1.0, end))
        axis.set_ylabel("share of problems solved within τ [–]")
        axis.set_ylim(0.0, 1.03)
        figure.legend(loc="outside right upper")
    return figure
