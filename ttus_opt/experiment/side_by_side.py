"""Patients and settings of an experiment in parallel, by joblib or on dask.

All results are cached in files (`fits`, `boundary`, `rivals`, `uncertainties`), so that
a task returns only its name; the experiment then reads the files in order. The next
call repeats interrupted tasks only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ttus_opt.core import optional
from ttus_opt.experiment import rivals
from ttus_opt.experiment.boundary import boundary_errors
from ttus_opt.experiment.fits import PatientFits
from ttus_opt.experiment.patients import Patient
from ttus_opt.experiment.recordings import examine
from ttus_opt.experiment.settings import Setting
from ttus_opt.experiment.uncertainties import stated_uncertainty
from ttus_opt.fitting.path.task_pool import task_pool

if TYPE_CHECKING:
    from ttus_opt.experiment.result import Plan


class _Uncertainty(NamedTuple):
    """A setting whose uncertainty is to be checked."""

    setting: Setting


#: A setting to fit or whose uncertainty to check, a comparator's name, or None for the
#: boundary values
Task = Setting | _Uncertainty | str | None


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
    tasks: list[Task] = [*plan.settings, None, *plan.rivals]
    tasks += map(_Uncertainty, plan.with_uncertainty)
    with task_pool(plan.jobs, plan.dask) as run:
        for done in run(delayed(_examined)(who, plan, folder) for who in patients):
            begin(done)
        work = ((who, plan, folder, task) for task in tasks for who in patients)
        for done in run(delayed(_done)(*each) for each in work):
            begin(done)


def _examined(patient: Patient, plan: Plan, folder: Path) -> str:
    examine(patient, folder / patient.name, plan.resolution, lambda _: None)
    return f"{patient.name}: recordings"


def _done(patient: Patient, plan: Plan, folder: Path, task: Task) -> str:
    place, digest = folder / patient.name, patient.digest(plan.resolution)
    examination = examine(patient, place, plan.resolution, lambda _: None)
    fits = PatientFits(examination, place, plan.shape, digest)
    if isinstance(task, Setting):
        fits.fitted(task)
        return f"{patient.name}: {task.name}"
    if task is None:
        boundary_errors(fits, plan.weight, place / "boundary.json", fits.stamp)
        return f"{patient.name}: boundary values"
    if isinstance(task, _Uncertainty):
        stated_uncertainty(fits, task.setting, place, fits.stamp)
        return f"{patient.name}: uncertainty of {task.setting.name}"
    rivals.rival(fits, task, place, digest)
    return f"{patient.name}: {task}"
