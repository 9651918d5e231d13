"""Tables over the solvers' rows: ratios to the closed form, means, memory, growth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ttus_opt.benchmark.row import Row
from ttus_opt.report.tables import table

#: Shift of the geometric mean: runs far below it count as equally fast [s]
SHIFT = 1.0

MIB = 2.0**20

#: Statuses that are no failure of the solver: it was never run
NOT_RUN = ("refused", "not installed")


def solved(row: Row) -> bool:
    """Whether the answer passed the check."""
    return bool(row["status"] == "solved")


def was_run(row: Row) -> bool:
    """Whether the solver was there and could take the problem."""
    return row["status"] not in NOT_RUN


def worst_relative(row: Row) -> float | None:
    """The largest relative KKT residual [–]."""
    kkt = row["kkt"] or {}
    told = (v for k, v in kkt.items() if k.endswith("_relative") and v is not None)
    return max(told, default=None)


def group(row: Row) -> tuple[str, str]:
    """Case and formulation: what is compared with each other."""
    return row["case"], row["formulation"]


def shifted_geometric_mean(seconds: Sequence[float], shift: float = SHIFT) -> float:
    """exp(mean(log(t + s))) - s: one slow run does not decide, nor one of no time.

    Args:
        seconds: Times, at least one [s].
        shift: s [s].

    Returns:
        The mean [s].

    >>> shifted_geometric_mean([0.0, 3.0], shift=1.0)
    1.0
    """
    logs = [math.log(t + shift) for t in seconds]
    return math.exp(math.fsum(logs) / len(logs)) - shift


@dataclass(frozen=True)
class Score:
    """How one solver did.

    Attributes:
        solver: Its name.
        solved: Runs with a verified answer.
        run: Runs it was there for and could take.
        mean_first: Shifted geometric mean of first solves, a failure counted as its
            time limit [s].
        mean_again: The same of solves with other values.
    """

    solver: str
    solved: int
    run: int
    mean_first: float
    mean_again: float


def scores(rows: Sequence[Row]) -> list[Score]:
    """A score per solver that was run at all, most solved first, then fastest."""

    def mean(own: Sequence[Row], key: str) -> float:
        return shifted_geometric_mean(
            [
                row[key] if solved(row) and row[key] is not None else row["time_limit"]
                for row in own
            ]
        )

    found = []
    for solver in dict.fromkeys(row["solver"] for row in rows if was_run(row)):
        own = [row for row in rows if row["solver"] == solver and was_run(row)]
        means = mean(own, "seconds_first"), mean(own, "seconds_again")
        found.append(Score(solver, sum(map(solved, own)), len(own), *means))
    return sorted(found, key=lambda score: (-score.solved, score.mean_first))


def closed_form_table(rows: Sequence[Row], closed_form: str) -> str:
    """Every solver against Q p = d: difference of fields, time and memory ratios.

    Args:
        rows: All rows, finished.
        closed_form: Name of the reference.

    Returns:
        A Markdown table; empty where the reference has no answer at all.
    """
    keys = ("seconds_first", "seconds_again", "solver_memory_bytes")
    body = []
    for reference in rows:
        if reference["solver"] != closed_form or not solved(reference):
            continue
        for row in rows:
            if group(row) != group(reference) or not solved(row):
                continue
            if row is reference:
                told = ["reference", seconds(row[keys[0]]), seconds(row[keys[1]])]
                told.append(mebibytes(row[keys[2]]))
            else:
                told = [number(row["difference_from_closed_form"])]
                told += [ratio(row[key], reference[key]) for key in keys]
            body.append([*group(row), row["solver"], *told])
    header = ["case", "formulation", "solver", "difference of p", "time: first"]
    return table([*header, "again", "memory"], body) if body else ""


def row_table(rows: Sequence[Row]) -> str:
    """All rows of one case and formulation, fastest verified answer first."""
    header = ["solver", "status", "first [s]", "again [s]", "peak [MiB]"]
    header += ["solver [MiB]", "KKT", "objective", "gap", "iterations", "active limits"]

    def place(row: Row) -> tuple[bool, bool, float]:
        first = row["seconds_first"]
        return not solved(row), not was_run(row), math.inf if first is None else first

    body = [
        [
            row["solver"],
            row["status"] if solved(row) else _failure(row),
            seconds(row["seconds_first"]),
            seconds(row["seconds_again"]),
            mebibytes(row["peak_memory_bytes"]),
            mebibytes(row["solver_memory_bytes"]),
            number(worst_relative(row)),
            "–" if row["objective"] is None else f"{row['objective']:.8g}",
            number(row["objective_gap"]),
            str(row["iterations"] or "–"),
            "–" if row["active_limits"] is None else str(row["active_limits"]),
        ]
        for row in sorted(rows, key=place)
    ]
    return table(header, body)


def score_table(rows: Sequence[Row]) -> str:
    """Shifted geometric means per solver."""
    body = [
        [
            score.solver,
            f"{score.solved}/{score.run}",
            seconds(score.mean_first),
            seconds(score.mean_again),
        ]
        for score in scores(rows)
    ]
    return table(["solver", "solved", "first [s]", "again [s]"], body)


def memory_table(rows: Sequence[Row]) -> str:
    """Largest size of the process per stage [MiB]."""
    stages = list(dict.fromkeys(s for row in rows for s in row["memory_by_stage"]))
    body = [
        [
            *group(row),
            row["solver"],
            *(mebibytes(row["memory_by_stage"].get(stage)) for stage in stages),
        ]
        for row in rows
        if row["memory_by_stage"]
    ]
    return table(["case", "formulation", "solver", *stages], body)


def exponent(rows: Sequence[Row], key: str) -> float:
    """Exponent x of time ∝ V^x by least squares; NaN for fewer than two sizes.

    Args:
        rows: Of one solver on one formulation.
        key: Of the time.

    >>> told = [{"voxels": v, "t": 2e-3 * v, "status": "solved"} for v in (10, 1000)]
    >>> round(exponent(told, "t"), 12)
    1.0
    """
    told = [(row["voxels"], row[key]) for row in rows if solved(row) and row[key]]
    if len({voxels for voxels, _ in told}) < 2:
        return math.nan
    sizes, times_taken = np.log(told).T
    return float(np.polyfit(sizes, times_taken, 1)[0])


def growth_table(rows: Sequence[Row]) -> str:
    """Exponents of solvers that solved a formulation in two sizes; empty for none."""
    found = []
    for formulation, solver in dict.fromkeys(
        (row["formulation"], row["solver"]) for row in rows
    ):
        own = [
            row
            for row in sorted(rows, key=lambda row: row["voxels"])
            if (row["formulation"], row["solver"]) == (formulation, solver)
            and solved(row)
        ]
        powers = [exponent(own, f"seconds_{kind}") for kind in ("first", "again")]
        if not math.isnan(powers[0]):
            cases = f"{own[0]['case']} to {own[-1]['case']} ({len(own)})"
            laws = ["–" if math.isnan(x) else f"time ∝ V^{x:.2f}" for x in powers]
            found.append((powers[0], [formulation, solver, cases, *laws]))
    order = list(dict.fromkeys(row["formulation"] for row in rows))
    found.sort(key=lambda each: (order.index(each[1][0]), each[0]))
    header = ["formulation", "solver", "cases", "first", "again"]
    return table(header, [line for _, line in found]) if found else ""


def _failure(row: Row) -> str:
    """Status and, short, why."""
    if row["status"] == "not installed" or not row["detail"]:
        return str(row["status"])
    detail = row["detail"]
    detail = detail if len(detail) < 48 else detail[:45] + "…"
    return f"{row['status']}: {detail}".replace("|", "/")


def ratio(value: float | None, reference: float | None) -> str:
    """``value`` over ``reference``."""
    return "–" if value is None or not reference else times(value / reference)


def times(quotient: float | None) -> str:
    """A quotient of two figures."""
    if quotient is None:
        return "–"
    return f"× {quotient:.2g}" if quotient < 100 else f"× {quotient:.0f}"


def seconds(value: float | None) -> str:
    """Three digits."""
    return "–" if value is None else f"{value:.3g}"


def mebibytes(value: int | None) -> str:
    """A size in MiB."""
    return "–" if value is None else f"{value / MIB:.0f}"


def number(value: float | None) -> str:
    """Two digits with an exponent; zero as 0."""
    if value is None:
        return "–"
    return "0" if value == 0.0 else f"{value:.1e}"
