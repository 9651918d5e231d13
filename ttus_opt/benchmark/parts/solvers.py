"""Part ``solvers``: every solver on every formulation, by time, memory and residual."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.machine import Progress
from ttus_opt.benchmark.parts.base import Part
from ttus_opt.benchmark.pictures import LEGEND as PROFILE
from ttus_opt.benchmark.pictures import (
    pictures,
    profile_picture,
    profile_table,
    ranked,
)
from ttus_opt.benchmark.row import (
    ALL,
    AUTO,
    CLOSED_FORM,
    CLOSED_FORM_FITS,
    Row,
    RunSpec,
    Settings,
)
from ttus_opt.benchmark.solver_run import (
    FIELDS,
    NONZERO,
    measured,
    options_of,
    solver_of,
    version,
)
from ttus_opt.benchmark.summary import (
    SHIFT,
    closed_form_table,
    group,
    growth_table,
    memory_table,
    problem_table,
    row_table,
    score_table,
    solved,
    time_table,
)
from ttus_opt.contact.scene import Scene
from ttus_opt.core.arguments import expect_positive
from ttus_opt.core.errors import InputError
from ttus_opt.problem.formulation import available, load
from ttus_opt.problem.program import Program
from ttus_opt.problem.reduction import reduce
from ttus_opt.report.document import Block, Heading, Picture, Table, Text
from ttus_opt.solvers.base import Request, Solver
from ttus_opt.solvers.registry import solvers

#: Values of a row with an answer, None without one. (``case``, ``formulation``,
#: ``solver``, ``status``, ``voxels``, ``poses``, ``time_limit`` [s] always exist.)
FIGURES = {
    "seconds_assembly": "scene and program [s]",
    "seconds_first": "set-up and first solve, median of the repeats [s]",
    "seconds_again": "update with other values and solve again, median [s]",
    "cpu_first": "CPU time of set-up, first solve and its check, median [s]",
    "cpu_again": "CPU time of update, second solve and its check, median [s]",
    "taken": "the solver that auto chose",
    "seconds_each": "every repeat's ``first`` and ``again`` [s]",
    "peak_memory_bytes": "largest size of the run's own process; None without one",
    "solver_memory_bytes": "largest increase of it by set-up and solve",
    "memory_by_stage": "largest size of the process per stage",
    "kkt": "verified residuals, absolute and relative",
    "residual_reached": "largest relative residual of an ended run's last answer",
    "objective": "at the answer",
    "iterations": "of the first solve",
    "active_limits": "bounds and inequality rows with a nonzero multiplier",
    "objective_gap": "over the best verified objective, relative",
    "difference_from_closed_form": "norm of the difference of the fields, relative",
    "field_file": "file with p, shape (V,), in the folder of fields; or empty",
}


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


class SolversPart(Part):
    """One run per case, formulation and solver, its options those of the run."""

    name, key = "solvers", "rows"
    title = "Solvers"
    parallel = True

    def plan(self, cases: Sequence[CaseSpec], settings: Settings) -> list[RunSpec]:
        """All runs, the reference of each formulation first."""
        check(settings)
        runs = []
        for case in cases:
            small = _small_scene(case)
            for formulation in _formulations(settings):
                common = {
                    "formulation": formulation,
                    **version(Path(formulation)),
                    "options": _accepted(formulation, settings, small),
                    "tolerance": settings.tolerance,
                    "repeat": settings.repeat,
                }
                runs += [
                    RunSpec(self.name, case, {**common, **solver}, settings.time_limit)
                    for solver in _solvers(case, settings)
                ]
        return runs

    def refused(self, specs: Sequence[RunSpec]) -> dict[str, Row]:
        """Rows of runs whose solver is not installed or refuses the problem."""
        rows: dict[str, Row] = {}
        programs: dict[tuple[str, str], Program] = {}
        for spec in specs:
            solver = solver_of(spec.options)
            if solver == AUTO:
                continue
            if not solver.installed:
                install = f"pip install {solver.pip_name}"
                rows[spec.key] = self.row(spec, "not installed", install)
                continue
            problem = spec.case_name, spec.options["formulation"]
            if problem not in programs:
                declared = load(
                    problem[1], _small_scene(spec.scene_case), **spec.options["options"]
                )
                programs[problem] = reduce(declared.compile()).program
            why = solver.refusal(programs[problem])
            if why:
                rows[spec.key] = self.row(spec, "refused", why)
        return rows

    def measure(self, spec: RunSpec, begin: Progress) -> list[Row]:
        """Solve, and again with other values."""
        return [measured(spec, begin)]

    def row(self, spec: RunSpec, status: str, detail: str) -> Row:
        """The row with all its keys, without values."""
        case = spec.scene_case
        return {
            "key": spec.key,
            "case": case.name,
            "formulation": Path(spec.options["formulation"]).stem,
            "solver": spec.options["solver"],
            "status": status,
            "voxels": case.n_voxels,
            "poses": case.n_poses,
            "time_limit": spec.time_limit,
            **dict.fromkeys(FIGURES),
            "seconds_each": {},
            "memory_by_stage": {},
            "field_file": "",
            "detail": detail,
        }

    def finished(
        self, rows: Sequence[Row], settings: Settings, output: Path
    ) -> list[Row]:
        """Rows with gap to the best and difference from the closed form."""
        best: dict[tuple[str, str], float] = {}
        reference: dict[tuple[str, str], Row] = {}
        for row in filter(solved, rows):
            problem = group(row)
            best[problem] = min(best.get(problem, math.inf), row["objective"])
            if row["solver"] == settings.reference:
                reference[problem] = row
        result = []
        for row in rows:
            problem, gap, difference = group(row), None, None
            if solved(row):
                least = best[problem]
                gap = (row["objective"] - least) / max(abs(least), 1e-300)
                difference = _difference(row, reference.get(problem), output / FIELDS)
            filled = {"objective_gap": gap, "difference_from_closed_form": difference}
            result.append(row | filled)
        return result

    def table(self, rows: Sequence[Row]) -> Table:
        """All rows, fastest verified answer first."""
        return row_table(rows)

    def text(self, rows: Sequence[Row], settings: Settings) -> list[Block]:
        """All tables in short."""
        parts: list[Block] = []
        groups = _groups(rows)
        if len(groups) > MANY:
            parts += [
                Text("Solved of those run, and the fastest:"),
                problem_table(rows),
            ]
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

    def report(self, rows: Sequence[Row], settings: Settings) -> list[Block]:
        """Its sections, the closed form first."""
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
            blocks += [
                Heading(f"{case} ({size}{made}): {formulation}"),
                row_table(runs),
            ]
        blocks += [Heading("Over all"), Text(MEANS), score_table(rows), Text(LEGEND)]
        if settings.memory:
            blocks += [Heading("Memory by stage [MiB]"), memory_table(rows)]
        blocks += [Heading("Time, memory and residual")]
        if laws := growth_table(rows):
            blocks += [Text(GROWTH), laws]
        return [*blocks, *pictures(rows)]


def check(settings: Settings) -> None:
    """Validate the settings.

    Raises:
        InputError: An unknown solver, or a number out of range.
    """
    for given in (*settings.solvers, settings.reference):
        if given not in ("", ALL):
            options_of(given)
    if settings.reference and not settings.reference.startswith(CLOSED_FORM):
        raise InputError(
            f"the reference must be a closed form, got {settings.reference!r}: "
            "choose closed_form, closed_form_pardiso, none or auto"
        )
    Request(settings.tolerance, settings.time_limit)  # validates both
    if settings.repeat < 1:
        raise InputError(f"repeat must be at least 1, got {settings.repeat}")
    expect_positive(settings.weight, "weight")


def _formulations(settings: Settings) -> list[str]:
    """Names and paths, each once; `ALL` stands for every formulation."""
    shelf_names = [info.name for info in available()]
    given = [
        name
        for each in settings.formulations
        for name in (shelf_names if each == ALL else [each])
    ]
    return list(dict.fromkeys(given))


def _solvers(case: CaseSpec, settings: Settings) -> list[dict[str, Any]]:
    """Options of a case's solvers, its reference first."""
    fits = case.n_voxels <= CLOSED_FORM_FITS
    every = [
        name
        for name, solver in solvers().items()
        if solver.installed and (fits or not name.startswith(CLOSED_FORM))
    ]
    given: list[str | Path | Solver] = []
    if settings.reference and (fits or settings.closed_form != AUTO):
        given = [settings.reference]
    for each in settings.solvers or (ALL,):
        given += every if each == ALL else [each]
    found = [options_of(each) for each in given]
    return list({options["solver"]: options for options in found}.values())


def _small_scene(case: CaseSpec) -> Scene:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return case.small().scene()


def _accepted(formulation: str, settings: Settings, small: Scene) -> dict[str, Any]:
    """Options of a formulation: its weights, and those given by the user."""
    known = {info.name: info.options for info in available()}
    weights: Mapping[str, float] = dict.fromkeys(
        ("force_weight", "torque_weight"), settings.weight
    )
    if formulation in known:
        weights = {k: v for k, v in weights.items() if k in known[formulation]}
    else:
        try:
            load(formulation, small, **weights)
        except InputError:  # a user's file with other options
            weights = {}
    accepted = {**weights, **settings.options}
    load(formulation, small, **accepted)
    return accepted


def _difference(row: Row, reference: Row | None, fields: Path) -> float | None:
    """‖p - p_ref‖ / ‖p_ref‖; None if a field is missing."""
    if reference is None or not (row["field_file"] and reference["field_file"]):
        return None
    files = [fields / each["field_file"] for each in (row, reference)]
    if not all(file.exists() for file in files):
        return None
    p, other = (np.load(file) for file in files)
    return float(np.linalg.norm(p - other) / np.linalg.norm(other))


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


PART = SolversPart()
