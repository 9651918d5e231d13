"""Performance profiles: how often a solver is within a factor of the fastest.

ρ_s(τ) is the fraction of problems p that solver s solves with
t_{p,s} ≤ τ min_s' t_{p,s'} (E. D. Dolan and J. J. Moré, Benchmarking optimization
software with performance profiles, Mathematical Programming 91, 2002, eq. 2.1). ρ_s(1)
is how often it is the fastest, ρ_s for large τ how many problems it solves. Refused and
failed problems count as not solved; problems that no solver solved are left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from ttus_opt.benchmark.row import Row
from ttus_opt.benchmark.summary import group, solved
from ttus_opt.report.document import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
    from ttus_opt.benchmark.pictures import solver_styles
    from ttus_opt.report.plots.canvas import look, new_figure

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
