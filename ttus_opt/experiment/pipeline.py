"""The paper's experiment on three phantom patients, from recordings to a report.

Patients and settings may run in parallel, by joblib or on dask. All results are cached
in files (`fits`, `boundary`, `uncertainties`), so that a task returns only
its name; the experiment then reads the files in order. The next call repeats
interrupted tasks only.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np

from ttus_opt.core import io, optional
from ttus_opt.core.arguments import chosen
from ttus_opt.core.errors import GeometryError, InputError
from ttus_opt.core.saved_results import write_json
from ttus_opt.experiment.boundary import boundary_errors
from ttus_opt.experiment.fits import PREFIX, PatientFits, Row
from ttus_opt.experiment.patients import Patient, examine, names, patients
from ttus_opt.experiment.result import (
    FIGURES,
    ITSELF,
    REPORTS,
    ExperimentResult,
    PatientResult,
    Plan,
)
from ttus_opt.experiment.uncertainties import stated_uncertainty
from ttus_opt.fitting.path.task_pool import task_pool
from ttus_opt.report.metrics import as_rendered, compare
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.voxmap import Boundary, Voxmap

#: Title of the task of boundary values
BOUNDARY = "boundary values"


def _tasks(plan: Plan) -> dict[str, Callable[[PatientFits], Any]]:
    """What is computed of every patient, or read from its files, by title."""
    tasks: dict[str, Callable[[PatientFits], Any]] = {}
    for each in plan.settings:
        tasks[each.name] = partial(PatientFits.fitted, setting=each)
    tasks[BOUNDARY] = lambda fits: boundary_errors(fits, plan.weight)
    for name in plan.rivals:
        tasks[PREFIX + name] = partial(PatientFits.rival, name=name)
    for each in plan.with_uncertainty:
        title = f"uncertainty of {each.name}"
        tasks[title] = partial(stated_uncertainty, setting=each)
    return tasks


def do_ahead(
    patients: Sequence[Patient],
    plan: Plan,
    folder: Path,
    begin: Callable[[str], None],
) -> None:
    """Examine all patients, then do every task of each, several at a time.

    Args:
        patients: The patients.
        plan: Options, with ``jobs`` and ``dask``.
        folder: Folder of the experiment; every worker must see it.
        begin: Called with the name of every finished task.

    Raises:
        MissingPackageError: joblib or dask is not installed.
        InputError: No scheduler answers.
    """
    delayed = optional.load("joblib", "parallel").delayed
    with task_pool(plan.jobs, plan.dask) as run:
        for done in run(delayed(_done)(who, plan, folder) for who in patients):
            begin(done)
        work = ((who, plan, folder, task) for task in _tasks(plan) for who in patients)
        for done in run(delayed(_done)(*each) for each in work):
            begin(done)


def _done(patient: Patient, plan: Plan, folder: Path, task: str = "") -> str:
    """Do one task of a patient, without one only examine it; what to say of it."""
    fits = _fits(patient, plan, folder, lambda _: None)
    if task:
        _tasks(plan)[task](fits)
    return f"{patient.name}: {task or 'recordings'}"


def _fits(
    patient: Patient, plan: Plan, folder: Path, begin: Callable[[str], None]
) -> PatientFits:
    """The fits of a patient, after its examination."""
    place, resolution = folder / patient.name, plan.resolution
    examination = examine(patient, place, resolution, begin)
    return PatientFits(examination, place, plan.shape, patient.digest(resolution))


def run(
    folder: str | os.PathLike[str],
    plan: Plan | None = None,
    *,
    progress: Callable[[str], None] | None = None,
) -> ExperimentResult:
    """Run the experiment; a second call in the same folder resumes it.

    Args:
        folder: Folder for recordings, fields, errors, figures, ``report.md``,
            ``report.html`` and ``results.json``; created if missing.
        plan: Options of the experiment.
        progress: Called with each stage as it begins, at most `n_stages` times.

    Raises:
        InputError: An unknown formulation, patient or comparator, or a shape that is
            too coarse for a patient.
        MissingPackageError: scikit-fem is not installed (extra ``phantom``) and the
            recordings do not exist yet; or joblib or dask, where requested.
        FileError: The folder cannot be written to.
    """
    from ttus_opt.experiment.report import write_reports

    todo, out = plan or Plan(), Path(folder)
    begin = progress or (lambda stage: None)
    _tasks(todo)  # refuses unknown names
    wanted = _wanted(todo)
    for name in (*REPORTS, FIGURES + "/boundary.png"):
        io.check_output(out / name)
    for name in wanted:
        io.check_output(out / name / "digest.txt")
    scan = None
    if todo.torso is not None:
        begin("surface of the scanned torso")
        scan = _scanned(todo, out)
    everyone = {each.name: each for each in patients(scan)}
    chosen = [everyone[name] for name in wanted]
    for each in chosen:
        _require_resolved(each, todo.shape)
    io.made_folder(out)
    if todo.jobs > 1 or todo.dask:
        do_ahead(chosen, todo, out, begin)
    results = tuple(_on_patient(each, todo, out, begin) for each in chosen)
    result = ExperimentResult(todo, results)
    begin("figures and reports")
    write_json(out / "results.json", result.as_dict())
    write_reports(out, result)
    return result


def n_stages(plan: Plan) -> int:
    """Most calls of ``progress`` by `run`."""
    each = 3 + len(plan.settings) + len(plan.rivals) + len(plan.with_uncertainty)
    passes = 2 if plan.jobs > 1 or plan.dask else 1
    return 2 + passes * each * len(plan.patients or patients())


def _wanted(plan: Plan) -> tuple[str, ...]:
    """Names of the patients, each once; `InputError` for an unknown one."""
    everyone = names(scanned=plan.torso is not None)
    return chosen(plan.patients, everyone, "patient", every="") or everyone


def _require_resolved(patient: Patient, shape: tuple[int, int, int]) -> None:
    """Refuse a grid that is too coarse for a patient, before anything is simulated."""
    for boundary in get_args(Boundary):
        try:
            Voxmap.from_surface(patient.surface(), shape=shape, boundary=boundary)
        except GeometryError as error:
            what = str(error).partition(":")[0]
            raise InputError(
                f"shape {shape} is too coarse for {patient.name} ({what}): give more "
                "voxels"
            ) from error


def _scanned(plan: Plan, folder: Path) -> Surface:
    """The surface of the scan, extracted once."""
    from ttus_opt.scan.cloud import read_cloud
    from ttus_opt.scan.extraction import extract_surface
    from ttus_opt.scan.frame import Axis

    assert plan.torso is not None
    path = io.existing_file(plan.torso, "torso")
    file = folder / f"scan-{io.sha256(path)[:12]}-{plan.torso_unit}.nc"
    if not file.exists():
        cloud = read_cloud(path, unit=plan.torso_unit)  # type: ignore[arg-type]  # checked there
        axis = Axis.from_cloud(cloud)
        extract_surface(cloud, axis=axis, n_theta=120, n_z=40).save(file)
    return Surface.load(file)


def _on_patient(
    patient: Patient, plan: Plan, folder: Path, begin: Callable[[str], None]
) -> PatientResult:
    fits, found = _fits(patient, plan, folder, begin), {}
    for title, task in _tasks(plan).items():
        begin(f"{patient.name}: {title}")
        found[title] = task(fits)
    return PatientResult(
        fits.examination,
        {each.name: found[each.name] for each in plan.settings},
        found[BOUNDARY],
        tuple(found[PREFIX + name] for name in plan.rivals),
        tuple(found[f"uncertainty of {s.name}"] for s in plan.with_uncertainty),
        _itself(fits),
    )


def _itself(fits: PatientFits) -> tuple[Row, ...]:
    """Errors of the phantom at the reported poses against measured wrenches."""
    rows = []
    for recording, recorded in fits.examination.itself.items():
        assert recorded.force is not None
        assert recorded.torque is not None
        rendered = as_rendered(np.hstack([recorded.force, recorded.torque]))
        errors = compare(fits.examination.measured[recording], rendered)
        rows.append(fits.row(ITSELF, recording, "measured", errors))
    return tuple(rows)
