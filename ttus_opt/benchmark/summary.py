"""Tables over the solvers' rows: ratios to the closed form, means, memory, growth."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ttus_opt.benchmark.row import Row
from ttus_opt.report.document import Table

#: Shift of the geometric mean; much shorter runs count as equal [s]
SHIFT = 1.0

MIB = 2.0**20

#: Statuses of runs that were not started
NOT_RUN = ("refused", "not installed")


def solved(row: Row) -> bool:
    """Whether the answer was verified."""
    return bool(row["status"] == "solved")


def was_run(row: Row) -> bool:
    """Whether the solver was installed and accepted the problem."""
    return row["status"] not in NOT_RUN


def worst_relative(row: Row) -> float | None:
    """The largest relative KKT residual, or the last of a run that was ended [–]."""
    kkt = row["kkt"] or {}
    residuals = (v for k, v in kkt.items() if k.endswith("_relative") and v is not None)
    return max(residuals, default=row.get("residual_reached"))


def group(row: Row) -> tuple[str, str]:
    """The problem of a row: case and formulation."""
    return row["case"], row["formulation"]


def shifted_geometric_mean(seconds: Sequence[float], shift: float = SHIFT) -> float:
    """exp(mean(log(t + s))) - s, robust to single slow or very fast runs [s].

    >>> shifted_geometric_mean([0.0, 3.0], shift=1.0)
    1.0
    """
    logs = [math.log(t + shift) for t in seconds]
    return math.exp(math.fsum(logs) / len(logs)) - shift


def scores(rows: Sequence[Row]) -> list[Row]:
    """Summary per solver, sorted by solved problems, then by time.

    Returns:
        ``solver``, ``solved``, ``run`` and the shifted geometric means ``first`` and
        ``again``, with failures counted as the time limit [s].
    """
    ranking = []
    for solver in dict.fromkeys(row["solver"] for row in rows if was_run(row)):
        runs = [row for row in rows if row["solver"] == solver and was_run(row)]
        score = {"solver": solver, "solved": sum(map(solved, runs)), "run": len(runs)}
        for kind in ("first", "again"):
            score[kind] = shifted_geometric_mean([_counted(row, kind) for row in runs])
        ranking.append(score)
    return sorted(ranking, key=lambda score: (-score["solved"], score["first"]))


def _counted(row: Row, kind: str) -> float:
    """Seconds of a solve, or the time limit if there is no answer."""
    taken = row[f"seconds_{kind}"] if solved(row) else None
    return float(row["time_limit"] if taken is None else taken)


def score_table(rows: Sequence[Row]) -> Table:
    """`scores` as a table."""
    body = []
    for score in scores(rows):
        times = seconds(score["first"]), seconds(score["again"])
        body.append([score["solver"], f"{score['solved']}/{score['run']}", *times])
    return Table(["solver", "solved", "first [s]", "again [s]"], body)


def closed_form_table(rows: Sequence[Row], closed_form: str) -> Table:
    """Every solver against the closed form: difference of fields, time and memory.

    Args:
        rows: All rows, finished.
        closed_form: Name of the reference.

    Returns:
        A table; empty if the reference has no answer.
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
                cells = ["reference", seconds(row[keys[0]]), seconds(row[keys[1]])]
                cells.append(mebibytes(row[keys[2]]))
            else:
                cells = [number(row["difference_from_closed_form"])]
                cells += [ratio(row[key], reference[key]) for key in keys]
            body.append([*group(row), row["solver"], *cells])
    header = ["case", "formulation", "solver", "difference of p", "time: first"]
    return Table([*header, "again", "memory"], body)


def problem_table(rows: Sequence[Row]) -> Table:
    """A line per problem: how many solvers solved it, and the three fastest."""
    body = []
    for problem in dict.fromkeys(map(group, rows)):
        runs = [row for row in rows if group(row) == problem]
        best = sorted(filter(solved, runs), key=lambda row: row["seconds_first"])
        named = [f"{r['solver']} {seconds(r['seconds_first'])}" for r in best[:3]]
        count = f"{len(best)}/{sum(map(was_run, runs))}"
        body.append([*problem, count, *named, *["–"] * (3 - len(named))])
    header = ["case", "formulation", "solved", "fastest [s]", "2.", "3."]
    return Table(header, body)


def time_table(rows: Sequence[Row]) -> Table:
    """Seconds of the first solve: a line per problem, a column per solver.

    Failures have their reason in brackets; a dash is a solver that was not run.
    """
    names = [score["solver"] for score in scores(rows)]
    body = []
    for problem in dict.fromkeys(map(group, rows)):
        by_solver = {row["solver"]: row for row in rows if group(row) == problem}
        body.append([*problem, *(_time(by_solver.get(name)) for name in names)])
    return Table(["case", "formulation", *names], body)


def _time(row: Row | None) -> str:
    if row is None or not was_run(row):
        return "–"
    return seconds(row["seconds_first"]) if solved(row) else f"({row['status']})"


def row_table(rows: Sequence[Row]) -> Table:
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
    return Table(header, body)


def memory_table(rows: Sequence[Row]) -> Table:
    """Largest size of the process per stage [MiB]."""
    known = [row for row in rows if row["memory_by_stage"]]
    stages = list(dict.fromkeys(s for row in known for s in row["memory_by_stage"]))
    body = []
    for row in known:
        sizes = [mebibytes(row["memory_by_stage"].get(stage)) for stage in stages]
        body.append([*group(row), row["solver"], *sizes])
    return Table(["case", "formulation", "solver", *stages], body)


def exponent(rows: Sequence[Row], key: str) -> float:
    """Exponent x of time ∝ V^x by least squares; NaN for fewer than two sizes.

    >>> rows = [{"voxels": v, "t": 2e-3 * v, "status": "solved"} for v in (10, 1000)]
    >>> round(exponent(rows, "t"), 12)
    1.0
    """
    known = [(row["voxels"], row[key]) for row in rows if solved(row) and row[key]]
    if len({voxels for voxels, _ in known}) < 2:
        return math.nan
    sizes, taken = np.log(known).T
    return float(np.polyfit(sizes, taken, 1)[0])


def growth_table(rows: Sequence[Row]) -> Table:
    """Exponents of solvers with two sizes of a formulation; empty without any."""
    growths = []
    rows = sorted(filter(solved, rows), key=lambda row: row["voxels"])
    for place in dict.fromkeys((row["formulation"], row["solver"]) for row in rows):
        runs = [row for row in rows if (row["formulation"], row["solver"]) == place]
        powers = [exponent(runs, f"seconds_{kind}") for kind in ("first", "again")]
        if not math.isnan(powers[0]):
            cases = f"{runs[0]['case']} to {runs[-1]['case']} ({len(runs)})"
            laws = ["–" if math.isnan(x) else f"time ∝ V^{x:.2f}" for x in powers]
            growths.append((place[0], powers[0], [*place, cases, *laws]))
    growths.sort(key=lambda each: each[:2])
    header = ["formulation", "solver", "cases", "first", "again"]
    return Table(header, [line for *_, line in growths])


def _failure(row: Row) -> str:
    """Status and a short reason."""
    status, detail = row["status"], row["detail"]
    if status == "not installed" or not detail:
        return str(status)
    detail = detail if len(detail) < 48 else detail[:45] + "…"
    return f"{status}: {detail}".replace("|", "/")


def ratio(value: float | None, reference: float | None) -> str:
    """``value`` over ``reference``."""
    return "–" if value is None or not reference else times(value / reference)


def times(quotient: float) -> str:
    """A quotient of two figures."""
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
