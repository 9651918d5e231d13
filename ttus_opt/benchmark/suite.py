"""The whole benchmark: what to run, in which order, saved as it comes.

Rows are appended to ``rows.jsonl`` in the output folder; a run that is there already
is not run again, so that an interrupted benchmark goes on where it stopped.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.isolation import run_isolated
from ttus_opt.benchmark.memory import available_bytes
from ttus_opt.benchmark.row import Row, RunSpec
from ttus_opt.errors import InputError
from ttus_opt.problem import formulation as shelf
from ttus_opt.problem.program import Program
from ttus_opt.problem.reduction import reduce
from ttus_opt.scene import Scene
from ttus_opt.solvers.base import Request
from ttus_opt.solvers.registry import solvers

#: Weight of force and torque rows by default [–]
WEIGHT = 1e-2

#: The same by option, as it is given to every formulation that has them
WEIGHTS = {"force_weight": WEIGHT, "torque_weight": WEIGHT}

#: As the reference: `CLOSED_FORM` where it fits the case
AUTO = "auto"

#: The reference by default, and the largest case it fits [voxels]: factorising Q takes
#: time ∝ V² (a minute on S), and passes the default time limit soon beyond
CLOSED_FORM, CLOSED_FORM_FITS = "closed_form", 100_000

#: Part of the memory available at the start that one run may take
MEMORY_PART = 0.8


@dataclass(frozen=True)
class Suite:
    """A benchmark to run.

    Attributes:
        cases: The scenes.
        formulations: Names or paths.
        solvers: Names; empty for every one installed, closed forms on cases of up to
            `CLOSED_FORM_FITS` voxels only.
        output: Folder of the results.
        closed_form: Name of the solver whose answer is the reference; "" for none;
            `AUTO` for the closed form on cases of up to `CLOSED_FORM_FITS` voxels.
        options: Formulation options beside the weights.
        tolerance: Largest relative KKT residual of a solution [–].
        time_limit: Most seconds of one solve [s].
        repeat: How many times each is measured.
        jobs: Runs at the same time; times are comparable with one only.
        dask: Address of a dask scheduler; "" for this machine.
        memory_limit: Largest size of one run's process [byte]; None for a part of
            what is available.
        weight: Of force and torque rows in every formulation that has them [–].
    """

    cases: Sequence[CaseSpec]
    formulations: Sequence[str]
    solvers: Sequence[str]
    output: Path
    closed_form: str = AUTO
    options: Mapping[str, Any] = field(default_factory=dict)
    tolerance: float = 1e-6
    time_limit: float = 600.0
    repeat: int = 1
    jobs: int = 1
    dask: str = ""
    memory_limit: int | None = None
    weight: float = WEIGHT

    @property
    def reference(self) -> str:
        """Name of the reference on cases that have one; "" for none at all."""
        return CLOSED_FORM if self.closed_form == AUTO else self.closed_form

    @property
    def rows_file(self) -> Path:
        """Where the rows are saved."""
        return self.output / "rows.jsonl"

    @property
    def fields(self) -> Path:
        """Folder of the fields."""
        return self.output / "fields"

    @property
    def allowance(self) -> int | None:
        """Largest size of one run's process now; None for no limit [byte]."""
        if self.memory_limit is not None or self.dask:
            return self.memory_limit
        available = available_bytes()
        if available is None:
            return None
        return int(MEMORY_PART * available / max(self.jobs, 1))

    def plan(self) -> list[RunSpec]:
        """Every run, the reference of a formulation before the others.

        Raises:
            InputError: Unknown solver, formulation or option, or a number out of
                range: told before anything runs.
        """
        self._check()
        runs = []
        for case in self.cases:
            names = self._names(case)
            small = _small_scene(case)
            for formulation in self.formulations:
                weights = dict.fromkeys(WEIGHTS, self.weight)
                options = _accepted(formulation, weights, self.options, small)
                runs += [
                    RunSpec(
                        case,
                        formulation,
                        name,
                        options,
                        self.tolerance,
                        self.time_limit,
                        self.repeat,
                    )
                    for name in names
                ]
        return runs

    def done(self) -> dict[str, Row]:
        """Rows of an earlier run in the same folder, by key."""
        if not self.rows_file.exists():
            return {}
        found = {}
        for line in self.rows_file.read_text("utf-8").splitlines():
            try:
                row = Row(**json.loads(line))
            except (json.JSONDecodeError, TypeError):
                continue  # cut off by the interruption, or of another version
            found[row.key] = row
        return found

    def run(self, told: Callable[[Row], None] | None = None) -> list[Row]:
        """Run what is missing; all rows, finished, in the order of the plan.

        Args:
            told: Called with every row as it comes, earlier ones included.

        Returns:
            Rows with gap and difference filled in.

        Raises:
            InputError: As `plan`, or dask is asked for and not installed.
        """
        plan = self.plan()
        rows = {k: v for k, v in self.done().items() if k in {s.key for s in plan}}
        told = told or (lambda row: None)
        for row in rows.values():
            told(row)
        missing = [spec for spec in plan if spec.key not in rows]
        refused = _refusals(missing)
        self.output.mkdir(parents=True, exist_ok=True)
        open_runs = [spec for spec in missing if spec.key not in refused]
        for row in self._results(list(refused.values()), open_runs):
            rows[row.key] = row
            with self.rows_file.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row.as_dict()) + "\n")
            told(row)
        return finished([rows[spec.key] for spec in plan], self.reference, self.fields)

    def _results(self, known: list[Row], runs: list[RunSpec]) -> Iterator[Row]:
        yield from known
        limit = self.allowance
        if self.jobs == 1 and not self.dask:
            for spec in runs:
                yield run_isolated(spec, self.fields, limit)
            return
        import joblib

        with _backend(self.dask):
            parallel = joblib.Parallel(
                n_jobs=self.jobs if not self.dask else -1,
                return_as="generator_unordered",
            )
            yield from parallel(
                joblib.delayed(run_isolated)(spec, self.fields, limit) for spec in runs
            )

    def _names(self, case: CaseSpec) -> list[str]:
        """Solvers of a case, the reference first where it has one."""
        fits = case.n_voxels <= CLOSED_FORM_FITS
        names = list(self.solvers) or [
            name
            for name, solver in solvers().items()
            if solver.installed and (fits or not name.startswith(CLOSED_FORM))
        ]
        if self.reference and (fits or self.closed_form != AUTO):
            names = [self.reference, *(n for n in names if n != self.reference)]
        return names

    def _check(self) -> None:
        known = solvers()
        for name in (*self.solvers, *([self.reference] if self.reference else [])):
            if name not in known:
                import difflib

                near = difflib.get_close_matches(name, known, n=3, cutoff=0.4)
                raise InputError(
                    f"unknown solver {name!r}, "
                    f"{'did you mean' if near else 'there are'} "
                    f"{', '.join(near or known)}?"
                )
        if self.reference and not self.reference.startswith(CLOSED_FORM):
            raise InputError(
                f"the reference must be a closed form, got {self.reference!r}: "
                "choose closed_form, closed_form_pardiso, none or auto"
            )
        Request(self.tolerance, self.time_limit)  # raises what is wrong with them
        for name, value in (("repeat", self.repeat), ("jobs", self.jobs)):
            if value < 1:
                raise InputError(f"{name} must be at least 1, got {value}")
        if not 0.0 < self.weight < np.inf:
            raise InputError(f"weight must be positive, got {self.weight}")


def finished(rows: Sequence[Row], closed_form: str, fields: Path) -> list[Row]:
    """Rows with their gap to the best and their difference from the closed form.

    Args:
        rows: All rows.
        closed_form: Name of the reference solver.
        fields: Folder of the fields.

    Returns:
        New rows, in the same order.
    """
    best: dict[tuple[str, str], float] = {}
    reference: dict[tuple[str, str], Row] = {}
    for row in rows:
        group = (row.case, row.formulation)
        if row.solved and row.objective is not None:
            best[group] = min(best.get(group, np.inf), row.objective)
            if row.solver == closed_form:
                reference[group] = row
    result = []
    for row in rows:
        group = (row.case, row.formulation)
        gap = difference = None
        if row.solved and row.objective is not None:
            gap = (row.objective - best[group]) / max(abs(best[group]), 1e-300)
            if group in reference:
                difference = _difference(row, reference[group], fields)
        result.append(
            replace(row, objective_gap=gap, difference_from_closed_form=difference)
        )
    return result


def _difference(row: Row, reference: Row, fields: Path) -> float | None:
    """‖p - p_ref‖ / ‖p_ref‖."""
    files = [fields / each.field_file for each in (row, reference)]
    if not all(each.field_file for each in (row, reference)):
        return None
    if not all(file.exists() for file in files):
        return None
    p, other = (np.load(file) for file in files)
    return float(np.linalg.norm(p - other) / np.linalg.norm(other))


def _small_scene(case: CaseSpec) -> Scene:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return case.small().build()


def _accepted(
    formulation: str,
    weights: Mapping[str, float],
    options: Mapping[str, Any],
    small: Scene,
) -> dict[str, Any]:
    """Weights where the formulation has them, and what was asked for.

    Raises:
        InputError: The formulation is unknown, or has no such option.
    """
    known = {info.name: info.options for info in shelf.available()}
    weights = dict(weights)
    if formulation in known:
        weights = {k: v for k, v in weights.items() if k in known[formulation]}
    else:
        try:
            shelf.load(formulation, small, **weights)
        except InputError:  # a user's file with other options
            weights = {}
    accepted = weights | dict(options)
    shelf.load(formulation, small, **accepted)
    return accepted


def _refusals(specs: Sequence[RunSpec]) -> dict[str, Row]:
    """Rows of runs whose solver is absent or cannot take the problem, by key."""
    rows: dict[str, Row] = {}
    programs: dict[tuple[str, str], Program] = {}
    for spec in specs:
        solver = solvers()[spec.solver]
        if not solver.installed:
            install = f"pip install {solver.pip_name}"
            rows[spec.key] = Row.failed(spec, "not installed", install)
            continue
        group = (spec.case.name, spec.formulation)
        if group not in programs:
            small = _small_scene(spec.case)
            declared = shelf.load(spec.formulation, small, **spec.options)
            programs[group] = reduce(declared.compile()).program
        why = solver.refusal(programs[group])
        if why:
            rows[spec.key] = Row.failed(spec, "refused", why)
    return rows


def _backend(dask: str) -> Any:
    """Joblib's backend: threads that wait for processes, or a dask cluster.

    Raises:
        InputError: dask is not installed, or no scheduler answers.
    """
    import joblib

    if not dask:
        return joblib.parallel_config(backend="threading")
    try:
        from distributed import (  # type: ignore[import-not-found,unused-ignore]
            Client,
        )
    except ImportError as error:
        raise InputError(
            "a dask scheduler was given but dask is not installed: "
            'pip install "dask[distributed]"'
        ) from error
    try:
        Client(dask, timeout="10s")
    except (OSError, ValueError) as error:
        raise InputError(f"no dask scheduler answers at {dask}: {error}") from error
    return joblib.parallel_config(backend="dask")
