"""The solvers' rows as sections of the report, and as tables on the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from ttus_opt.benchmark.pictures import LEGEND as PROFILE
from ttus_opt.benchmark.pictures import (
    profile_picture,
    profile_table,
    ranked,
)
from ttus_opt.benchmark.row import Row, Settings
from ttus_opt.benchmark.solver_run import NONZERO
from ttus_opt.benchmark.summary import (
    SHIFT,
    closed_form_table,
    group,
    growth_table,
    memory_table,
    problem_table,
    row_table,
    score_table,
    time_table,
)
from ttus_opt.report.document import Block, Heading, Picture, Text

#: With more problems the terminal shows only a line for each
MANY = 4

#: Fewest problems of a performance profile
FEWEST = 2

AGAINST = (
    "`{}` forms Q and factorises it. Difference is the Euclidean norm of the "
    "difference of the fields over that of the reference; times and the memory that "
    "set-up and solve add to the process are ratios to the reference's own, given in s "
    "and MiB."
)
NO_REFERENCE = (
    "`{}` has no answer here. It is run on cases it fits; `--closed-form` asks for one "
    "on any."
)
LEGEND = (
    "Every answer is checked here: KKT is the largest relative residual of the "
    "original problem, whatever the solver says of itself; of a run that was ended it "
    "is the last it had reached, and a dash if it had no answer yet. *First* "
    "includes set-up; *again* is taking in other measured values of the same structure "
    "and solving. Imports and compilation are done before on a small problem. *Gap* is "
    "the objective over the best verified one. *Peak* is the largest size of the "
    "process, *solver* what set-up and solve added at most. *Active limits* are the "
    f"bounds and inequality rows whose multiplier is above {NONZERO:g} of the largest."
)
MEANS = (
    f"Shifted geometric means (shift {SHIFT:g} s) over the problems a solver takes, a "
    "failure counted as its time limit."
)
TIMES = (
    "Seconds of the first solve, set-up included; in brackets why there is no verified "
    "answer, a dash if a solver cannot take the problem."
)
GROWTH = (
    "A power of V fitted by least squares to the verified answers, logarithm against "
    "logarithm; the number of cases in brackets, which may differ in poses as well."
)


def terminal(rows: Sequence[Row], settings: Settings) -> list[Block]:
    """All finished rows in short."""
    parts: list[Block] = []
    groups = _groups(rows)
    if len(groups) > MANY:
        parts += [Text("Solved of those run, and the fastest:"), problem_table(rows)]
    else:
        against = closed_form_table(rows, settings.reference)
        if against:
            parts += [Text("Against the closed form:"), against]
        for (case, formulation), runs in groups:
            size = f"{runs[0]['voxels']:,} voxels"
            parts += [Text(f"{case}, {formulation}, {size}:")]
            parts += [row_table(runs).without("objective")]  # the gap says it
    profile, n_problems = _profile(rows)
    if profile:
        head = f"Share of {n_problems} problems solved within τ times the fastest:"
        parts += [Text(head), profile_table(profile)]
    parts += [Text("Shifted geometric means:"), score_table(rows)]
    if settings.memory:
        parts += [Text("Memory by stage [MiB]:"), memory_table(rows)]
    return parts


def sections(rows: Sequence[Row], settings: Settings) -> list[Block]:
    """All finished rows as parts of the report."""
    from ttus_opt.benchmark.pictures import pictures

    blocks: list[Block] = []
    if reference := settings.reference:
        against = closed_form_table(rows, reference)
        blocks += [Heading("Against the closed form Q p = d")]
        blocks += [Text((AGAINST if against else NO_REFERENCE).format(reference))]
        blocks += [against] if against else []
    groups = _groups(rows)
    if len(groups) > 1:
        blocks += [Heading("Every problem"), problem_table(rows)]
        blocks += [Text(TIMES), time_table(rows)]
    blocks += _profile_section(rows)
    for (case, formulation), runs in groups:
        size = f"{runs[0]['voxels']:,} voxels, {runs[0]['poses'] or 'all'} poses"
        taken = [r["seconds_assembly"] for r in runs if r["seconds_assembly"]]
        made = f", assembly {min(taken):.2g} s" if taken else ""
        blocks += [Heading(f"{case} ({size}{made}): {formulation}"), row_table(runs)]
    blocks += [Heading("Over all"), Text(MEANS), score_table(rows), Text(LEGEND)]
    if settings.memory:
        blocks += [Heading("Memory by stage [MiB]"), memory_table(rows)]
    blocks += [Heading("Time, memory and residual")]
    if laws := growth_table(rows):
        blocks += [Text(GROWTH), laws]
    return [*blocks, *pictures(rows)]


def _profile(rows: Sequence[Row]) -> tuple[dict[str, list[float]], int]:
    """Ratios by solver, none with too few problems; number of problems."""
    profile = ranked(rows)
    n_problems = len(next(iter(profile.values()), []))
    return (profile if n_problems >= FEWEST else {}), n_problems


def _profile_section(rows: Sequence[Row]) -> list[Block]:
    """Performance profile as table and picture; nothing with too few problems."""
    profile, n_problems = _profile(rows)
    if not profile:
        return []
    head = [Heading("Performance profile"), Text(PROFILE.format(n=n_problems))]
    picture = Picture("profile.png", "performance profile", profile_picture(profile))
    return [*head, profile_table(profile), picture]


def _groups(rows: Sequence[Row]) -> list[tuple[tuple[str, str], list[Row]]]:
    """Rows by case and formulation, in order."""
    names = dict.fromkeys(map(group, rows))
    return [(name, [row for row in rows if group(row) == name]) for name in names]
