"""The benchmark's report: tables, pictures and the machine, in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ttus_opt import io
from ttus_opt.benchmark.active_limits import NONZERO
from ttus_opt.benchmark.growth import growth_table
from ttus_opt.benchmark.parts import registry
from ttus_opt.benchmark.pictures import (
    memory_against_size,
    residual_against_time,
    time_against_size,
)
from ttus_opt.benchmark.row import Row
from ttus_opt.benchmark.summary import (
    SHIFT,
    closed_form_table,
    memory_table,
    row_table,
    score_table,
)
from ttus_opt.report.plots.canvas import save_picture

#: File names in the output folder
REPORT, TIME_PICTURE, RESIDUAL_PICTURE = "report.md", "time.png", "residual.png"
MEMORY_PICTURE = "memory.png"


def write_page(
    folder: Path,
    rows: Sequence[Row],
    *,
    closed_form: str,
    command: str,
    machine: Mapping[str, str],
    memory: bool = False,
    parts: Mapping[str, Sequence[Mapping[str, Any]]] | None = None,
) -> Path:
    """Write report and pictures.

    Args:
        folder: Where to.
        rows: All rows of solvers, finished; none leaves their sections out.
        closed_form: Name of the reference solver.
        command: What was typed.
        machine: From `ttus_opt.benchmark.machine.describe`.
        memory: Add the table of memory by stage.
        parts: Rows of the other parts by name.

    Returns:
        The report's path.

    Raises:
        FileError: The folder cannot be written to.
    """
    lines = ["# Benchmark", "", f"`{command}`", ""]
    if rows:
        lines += _solvers(folder, rows, closed_form, memory)
    for name, found in (parts or {}).items():
        if found:
            part = registry.parts()[name]
            lines += [f"## {part.title}", "", part.legend, "", part.table(found), ""]
            lines += part.below(found, folder)
    lines += ["## Machine", "", *(f"- {name}: {it}" for name, it in machine.items())]
    lines.append("")
    report = folder / REPORT
    with io.replacing(report) as temporary:
        temporary.write_text("\n".join(lines), encoding="utf-8")
    return report


def _solvers(
    folder: Path, rows: Sequence[Row], closed_form: str, memory: bool
) -> list[str]:
    """Lines of the solvers' sections; writes their pictures."""
    save_picture(time_against_size(rows), folder / TIME_PICTURE)
    save_picture(memory_against_size(rows), folder / MEMORY_PICTURE)
    save_picture(residual_against_time(rows), folder / RESIDUAL_PICTURE)
    against = closed_form_table(rows, closed_form)
    lines = ["## Against the closed form Q p = d", ""]
    lines += (
        [
            f"`{closed_form}` forms Q and factorises it. Difference is the Euclidean "
            "norm of the difference of the fields over that of the reference; times "
            "and the memory that set-up and solve add to the process are ratios to "
            "the reference's own, given in s and MiB.",
            "",
            against,
        ]
        if against
        else [
            f"`{closed_form or 'no closed form'}` has no answer here. It is run on "
            "cases it fits; `--closed-form` asks for one on any."
        ]
    )
    for case, formulation in dict.fromkeys((r.case, r.formulation) for r in rows):
        own = [r for r in rows if (r.case, r.formulation) == (case, formulation)]
        size = f"{own[0].voxels:,} voxels, {own[0].poses or 'all'} poses"
        assembly = [r.seconds_assembly for r in own if r.seconds_assembly is not None]
        made = f", assembly {min(assembly):.2g} s" if assembly else ""
        lines += ["", f"## {case} ({size}{made}): {formulation}", "", row_table(own)]
    lines += [
        "",
        "## Over all",
        "",
        f"Shifted geometric means (shift {SHIFT:g} s) over the problems a solver "
        "takes, a failure counted as its time limit.",
        "",
        score_table(rows),
        "",
        "Every answer is checked here: KKT is the largest relative residual of the "
        "original problem, whatever the solver says of itself. *First* includes "
        "set-up; *again* is taking in other measured values of the same structure "
        "and solving. Imports and compilation are done before on a small problem. "
        "*Gap* is the objective over the best verified one. *Peak* is the largest "
        "size of the process, *solver* what set-up and solve added at most. *Active "
        f"limits* are the bounds and inequality rows whose multiplier is above "
        f"{NONZERO:g} of the largest.",
    ]
    if memory:
        lines += ["", "## Memory by stage [MiB]", "", memory_table(rows)]
    return [
        *lines,
        "",
        "## Time and memory against size",
        "",
        *_grown(rows),
        f"![time against voxels]({TIME_PICTURE})",
        "",
        f"![memory against voxels]({MEMORY_PICTURE})",
        "",
        "## Residual against time",
        "",
        f"![residual against time]({RESIDUAL_PICTURE})",
        "",
    ]


def _grown(rows: Sequence[Row]) -> list[str]:
    """Lines of the exponents, where there are two sizes."""
    laws = growth_table(rows)
    if not laws:
        return []
    return [
        "A power of V fitted by least squares to the verified answers, logarithm "
        "against logarithm; the number of cases in brackets, which may differ in "
        "poses as well.",
        "",
        laws,
        "",
    ]
