"""Part ``solvers``: every solver on every formulation, by time, memory and residual."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.parts.base import Part
from ttus_opt.benchmark.progress import Progress
from ttus_opt.benchmark.row import (
    ALL,
    AUTO,
    CLOSED_FORM,
    CLOSED_FORM_FITS,
    Row,
    RunSpec,
    Settings,
)
from ttus_opt.benchmark.solver_report import sections, terminal
from ttus_opt.benchmark.solver_run import AUTO as AUTO_SOLVER
from ttus_opt.benchmark.solver_run import (
    FIELDS,
    label,
    measured,
    options_of,
    solver_of,
    version,
)
from ttus_opt.benchmark.summary import row_table
from ttus_opt.contact.scene import Scene
from ttus_opt.core.arguments import expect_positive
from ttus_opt.core.errors import InputError
from ttus_opt.problem.formulation import available, load
from ttus_opt.problem.program import Program
from ttus_opt.problem.reduction import reduce
from ttus_opt.report.document import Block, Table
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
            if solver == AUTO_SOLVER:
                continue
            if not solver.installed:
                install = f"pip install {solver.pip_name}"
                rows[spec.key] = self.row(spec, "not installed", install)
                continue
            group = (spec.case_name, spec.options["formulation"])
            if group not in programs:
                declared = load(
                    group[1], _small_scene(spec.scene_case), **spec.options["options"]
                )
                programs[group] = reduce(declared.compile()).program
            why = solver.refusal(programs[group])
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
            "formulation": label(spec.options["formulation"]),
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
        for row in rows:
            if row["status"] == "solved":
                group = (row["case"], row["formulation"])
                best[group] = min(best.get(group, math.inf), row["objective"])
                if row["solver"] == settings.reference:
                    reference[group] = row
        result = []
        for row in rows:
            group, gap, difference = (row["case"], row["formulation"]), None, None
            if row["status"] == "solved":
                gap = (row["objective"] - best[group]) / max(abs(best[group]), 1e-300)
                difference = _difference(row, reference.get(group), output / FIELDS)
            filled = {"objective_gap": gap, "difference_from_closed_form": difference}
            result.append(row | filled)
        return result

    def table(self, rows: Sequence[Row]) -> Table:
        """All rows, fastest verified answer first."""
        return row_table(rows)

    def text(self, rows: Sequence[Row], settings: Settings) -> list[Block]:
        """All tables."""
        return terminal(rows, settings)

    def report(self, rows: Sequence[Row], settings: Settings) -> list[Block]:
        """Its sections, the closed form first."""
        return sections(rows, settings)


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
        return case.small().build()


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


PART = SolversPart()
