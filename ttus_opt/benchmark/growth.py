"""How time grows with the number of voxels: the exponent x of time ∝ V^x."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ttus_opt.benchmark.row import Row
from ttus_opt.report.tables import table


@dataclass(frozen=True)
class Growth:
    """A power law fitted to one solver's verified answers on one formulation.

    Attributes:
        formulation: Its name.
        solver: Its name.
        cases: The cases it was fitted to, smallest first.
        first: Exponent of first solves, set-up included [–].
        again: Exponent of re-solves; None where there are too few [–].
    """

    formulation: str
    solver: str
    cases: tuple[str, ...]
    first: float
    again: float | None


def exponent(sizes: Sequence[float], seconds: Sequence[float]) -> float:
    """Slope of log seconds over log size by least squares.

    Args:
        sizes: At least two different ones.
        seconds: As many times.

    Returns:
        x of time ∝ size^x [–].

    >>> round(exponent([10, 100, 1000], [2, 20, 200]), 12)
    1.0
    """
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def growths(rows: Sequence[Row]) -> list[Growth]:
    """Exponents of every solver that solved a formulation in at least two sizes.

    Args:
        rows: All rows.

    Returns:
        Formulation by formulation, least exponent first.
    """
    found = []
    for formulation, solver in dict.fromkeys((r.formulation, r.solver) for r in rows):
        own = sorted(
            (
                row
                for row in rows
                if (row.formulation, row.solver) == (formulation, solver) and row.solved
            ),
            key=lambda row: row.voxels,
        )
        first = _fitted(own, "seconds_first")
        if first is not None:
            cases = tuple(row.case for row in own)
            again = _fitted(own, "seconds_again")
            found.append(Growth(formulation, solver, cases, first, again))
    order = list(dict.fromkeys(row.formulation for row in rows))
    return sorted(found, key=lambda g: (order.index(g.formulation), g.first))


def _fitted(rows: Sequence[Row], name: str) -> float | None:
    """The exponent of one kind of time; None for fewer than two sizes."""
    told = [(row.voxels, getattr(row, name)) for row in rows if getattr(row, name)]
    if len({voxels for voxels, _ in told}) < 2:
        return None
    sizes, seconds = zip(*told, strict=True)
    return exponent(sizes, seconds)


def growth_table(rows: Sequence[Row]) -> str:
    """Exponents as a Markdown table; empty where no solver has two sizes.

    Args:
        rows: All rows.
    """
    body = [
        [
            growth.formulation,
            growth.solver,
            f"{growth.cases[0]} to {growth.cases[-1]} ({len(growth.cases)})",
            _law(growth.first),
            _law(growth.again),
        ]
        for growth in growths(rows)
    ]
    header = ["formulation", "solver", "cases", "first", "again"]
    return table(header, body) if body else ""


def _law(power: float | None) -> str:
    if power is None or not math.isfinite(power):
        return "–"
    return f"time ∝ V^{power:.2f}"
