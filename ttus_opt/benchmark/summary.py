"""Figures over many rows: shifted geometric means, ratios to the closed form."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ttus_opt.benchmark.row import Row
from ttus_opt.report.tables import table

#: Shift of the geometric mean: runs far below it count as equally fast [s]
SHIFT = 1.0

MIB = 2.0**20


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
        mean_again: The same of re-solves.
    """

    solver: str
    solved: int
    run: int
    mean_first: float
    mean_again: float


def scores(rows: Sequence[Row]) -> list[Score]:
    """A score per solver, most solved first, then fastest.

    Args:
        rows: All rows.

    Returns:
        Scores of the solvers that were run at all.
    """
    found = []
    for solver in dict.fromkeys(row.solver for row in rows):
        own = [row for row in rows if row.solver == solver and row.was_run]
        if not own:
            continue
        first = [_counted(row, row.seconds_first) for row in own]
        again = [_counted(row, row.seconds_again) for row in own]
        found.append(
            Score(
                solver,
                sum(row.solved for row in own),
                len(own),
                shifted_geometric_mean(first),
                shifted_geometric_mean(again),
            )
        )
    return sorted(found, key=lambda score: (-score.solved, score.mean_first))


def _counted(row: Row, seconds: float | None) -> float:
    """A time, or the time limit for a failure."""
    return seconds if row.solved and seconds is not None else row.time_limit


def closed_form_table(rows: Sequence[Row], closed_form: str) -> str:
    """Every solver against Q p = d: difference of fields, time and memory ratios.

    Args:
        rows: All rows, finished.
        closed_form: Name of the reference.

    Returns:
        A Markdown table; empty where the reference has no answer at all.
    """
    header = [
        "case",
        "formulation",
        "solver",
        "difference of p",
        "time: first",
        "again",
        "memory",
    ]
    body = []
    for reference in rows:
        if reference.solver != closed_form or not reference.solved:
            continue
        group = (reference.case, reference.formulation)
        for row in rows:
            if (row.case, row.formulation) != group or not row.solved:
                continue
            if row is reference:
                told = [
                    "reference",
                    seconds(row.seconds_first),
                    seconds(row.seconds_again),
                    mebibytes(row.solver_memory_bytes),
                ]
            else:
                told = [
                    number(row.difference_from_closed_form),
                    ratio(row.seconds_first, reference.seconds_first),
                    ratio(row.seconds_again, reference.seconds_again),
                    ratio(row.solver_memory_bytes, reference.solver_memory_bytes),
                ]
            body.append([row.case, row.formulation, row.solver, *told])
    return table(header, body) if body else ""


def row_table(rows: Sequence[Row]) -> str:
    """All rows of one case and formulation, fastest verified answer first.

    Args:
        rows: Rows of one group.

    Returns:
        A Markdown table.
    """
    header = [
        "solver",
        "status",
        "first [s]",
        "again [s]",
        "peak [MiB]",
        "solver [MiB]",
        "KKT",
        "objective",
        "gap",
        "iterations",
        "active limits",
    ]
    order = sorted(
        rows,
        key=lambda r: (
            not r.solved,
            not r.was_run,
            math.inf if r.seconds_first is None else r.seconds_first,
        ),
    )
    body = [
        [
            row.solver,
            row.status if row.solved else _failure(row),
            seconds(row.seconds_first),
            seconds(row.seconds_again),
            mebibytes(row.peak_memory_bytes),
            mebibytes(row.solver_memory_bytes),
            number(row.worst_relative),
            "–" if row.objective is None else f"{row.objective:.8g}",
            number(row.objective_gap),
            str(row.iterations) if row.iterations else "–",
            "–" if row.active_limits is None else str(row.active_limits),
        ]
        for row in order
    ]
    return table(header, body)


def score_table(rows: Sequence[Row]) -> str:
    """Shifted geometric means per solver.

    Args:
        rows: All rows.

    Returns:
        A Markdown table.
    """
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
    """Largest size of the process per stage [MiB].

    Args:
        rows: All rows.

    Returns:
        A Markdown table.
    """
    stages = list(dict.fromkeys(s for row in rows for s in row.memory_by_stage))
    body = [
        [
            row.case,
            row.formulation,
            row.solver,
            *(mebibytes(row.memory_by_stage.get(stage)) for stage in stages),
        ]
        for row in rows
        if row.memory_by_stage
    ]
    return table(["case", "formulation", "solver", *stages], body)


def _failure(row: Row) -> str:
    """Status and, short, why."""
    if row.status == "not installed" or not row.detail:
        return row.status
    detail = row.detail if len(row.detail) < 48 else row.detail[:45] + "…"
    return f"{row.status}: {detail}".replace("|", "/")


def ratio(value: float | None, reference: float | None) -> str:
    """``value`` over ``reference``, in words that say which way."""
    if value is None or not reference:
        return "–"
    return times(value / reference)


def times(quotient: float | None) -> str:
    """A quotient of two figures, in words that say which way."""
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
