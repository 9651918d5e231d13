"""The paper's experiment on three phantom patients, from recordings to a report."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

import numpy as np

from ttus_opt import io
from ttus_opt.errors import GeometryError, InputError
from ttus_opt.experiment import rivals
from ttus_opt.experiment.boundary import BoundaryError, boundary_errors
from ttus_opt.experiment.doubts import StatedDoubt, stated_doubt
from ttus_opt.experiment.fits import Fitted, PatientFits, write_kept
from ttus_opt.experiment.patients import Patient, names, patients
from ttus_opt.experiment.recordings import Examination, examine
from ttus_opt.experiment.rivals import Rival
from ttus_opt.experiment.scores import Row
from ttus_opt.experiment.settings import (
    FORMULATIONS,
    GIVEN,
    LAPLACE,
    PAPER_WITH,
    PAPER_WITHOUT,
    REFINED,
    WEIGHT,
    WEIGHTS,
    Setting,
    chosen,
    compared,
    distinct,
    without_torque,
)
from ttus_opt.experiment.side_by_side import do_ahead
from ttus_opt.fitting.weight_choice import checked_word
from ttus_opt.problem.formulation import LARGEST
from ttus_opt.report.metrics import as_rendered, compare
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.grid import CylindricalGrid
from ttus_opt.voxmap.voxmap import Boundary, Voxmap, check_memory

#: Files written at the end, and the folder of the pictures
REPORTS, FIGURES = ("report.md", "report.html", "results.json"), "figures"

#: The phantom's own wrench at the reported poses, as a setting
ITSELF = "phantom_itself"


@dataclass(frozen=True)
class Plan:
    """Options of the experiment.

    Attributes:
        shape: Voxels in r, θ and z [–].
        formulations: Formulations to compare, names or paths.
        weight: λ_f = λ_τ of formulations that do not choose their own.
        weights: ``auto`` fits these once more, with weights chosen from the recordings
            by marginal likelihood; ``default`` also adds the default model;
            ``given`` does neither.
        jobs: Number of parallel tasks.
        dask: Address of a dask scheduler for them, whose workers see the folder; ""
            for this machine.
        resolution: Factor of every node spacing of the finite elements; 1 is fine.
        torso: A scan for the skin of the third patient; None for a made-up one.
        torso_unit: Unit of that file.
        patients: Names of the patients; all when empty.
        comparators: Names of comparators, or ``("all",)``; none when empty.
        doubt: Also check the stated uncertainty of fits whose weights come from the
            recordings.
        refine: Also fit the default model on poses refined by the forces
            (`ttus_opt.refine_poses`).
    """

    shape: tuple[int, int, int] = (48, 120, 60)
    formulations: Sequence[str] = FORMULATIONS
    weight: float = WEIGHT
    resolution: float = 1.4
    torso: str | os.PathLike[str] | None = None
    torso_unit: str = "mm"
    patients: Sequence[str] = ()
    comparators: Sequence[str] = ()
    weights: str = GIVEN
    jobs: int = 1
    dask: str = ""
    doubt: bool = False
    refine: bool = False

    def __post_init__(self) -> None:
        """Validate numbers and words.

        Raises:
            InputError: A weight or resolution out of range, no job, a word not in
                `WEIGHTS`, or a shape that is too small or would not fit in memory.
        """
        if self.jobs < 1:
            raise InputError(f"jobs must be at least 1, got {self.jobs}")
        checked_word(self.weights, WEIGHTS)
        if not (0.0 < self.weight <= LARGEST and 0.3 <= self.resolution <= 10.0):
            raise InputError(
                f"the experiment needs a weight above 0, at most {LARGEST:g}, and a "
                f"resolution from 0.3 to 10, got {self.weight:g} and "
                f"{self.resolution:g}"
            )
        # only the counts matter here
        check_memory(CylindricalGrid(0.03, 0.06, 0.0, 0.1, self.shape))

    @property
    def settings(self) -> tuple[Setting, ...]:
        """All settings to fit, those of the paper's tables first.

        Raises:
            InputError: An unknown formulation, or a file whose name is taken.
        """
        others = compared(self.formulations, self.weight)
        eq10 = compared(("eq10",), self.weight)
        own = (PAPER_WITHOUT, PAPER_WITH, LAPLACE, without_torque(self.weight), *eq10)
        further = [each for each in others if each not in own]
        more = chosen(self.formulations, self.weights)
        return distinct((*own, *further, *more, *(REFINED,) * self.refine))

    @property
    def doubted(self) -> tuple[Setting, ...]:
        """Settings whose uncertainty is checked: weights come from the recordings."""
        own = compared(self.formulations, self.weight)
        itself = [each for each in own if not each.options]
        return (*itself, *chosen(self.formulations, self.weights)) * self.doubt

    @property
    def rivals(self) -> tuple[str, ...]:
        """Names of the comparators; `InputError` for an unknown one."""
        return rivals.chosen(self.comparators)


@dataclass(frozen=True)
class PatientResult:
    """Results of one patient.

    Attributes:
        examination: The recordings.
        fits: A fit per setting, by name.
        boundary: Errors over a decade of boundary values.
        rivals: The comparators.
        doubts: Stated uncertainty, of the settings where it was asked for.
        itself: Rows of the phantom's own wrench at the reported poses.
    """

    examination: Examination
    fits: dict[str, Fitted] = field(repr=False)
    boundary: tuple[BoundaryError, ...] = field(repr=False)
    rivals: tuple[Rival, ...] = field(repr=False)
    doubts: tuple[StatedDoubt, ...] = field(repr=False)
    itself: tuple[Row, ...] = field(repr=False)

    @property
    def patient(self) -> Patient:
        """The patient."""
        return self.examination.patient

    @property
    def rows(self) -> tuple[Row, ...]:
        """All rows."""
        fitted = [row for fit in self.fits.values() for row in fit.rows]
        others = [row for rival in self.rivals for row in rival.rows]
        return (*fitted, *others, *self.itself)


@dataclass(frozen=True)
class ExperimentResult:
    """Results of the experiment.

    Attributes:
        plan: Options of the experiment.
        patients: Results per patient.
    """

    plan: Plan
    patients: tuple[PatientResult, ...]

    @property
    def rows(self) -> tuple[Row, ...]:
        """A row per patient, recording, setting and reference wrench."""
        return tuple(row for patient in self.patients for row in patient.rows)

    @property
    def boundary(self) -> tuple[BoundaryError, ...]:
        """Errors over a decade of boundary values, of all patients."""
        return tuple(row for patient in self.patients for row in patient.boundary)

    def as_dict(self) -> dict[str, Any]:
        """All figures, for JSON."""
        return {
            "patients": {
                each.patient.name: {
                    "build": each.patient.build,
                    "seed": each.patient.seed,
                    "fits": {k: dict(v.facts) for k, v in each.fits.items()},
                    "comparators": {r.name: dict(r.facts) for r in each.rivals},
                    "doubt": {d.setting: d.as_dict() for d in each.doubts},
                }
                for each in self.patients
            },
            "shape": list(self.plan.shape),
            "weight": self.plan.weight,
            "resolution": self.plan.resolution,
            "rows": [row.as_dict() for row in self.rows],
            "boundary": [row.as_dict() for row in self.boundary],
        }


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
    settings, others, wanted = todo.settings, todo.rivals, _wanted(todo)
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
    results = tuple(
        _on_patient(each, todo, out / each.name, (settings, others), begin)
        for each in chosen
    )
    result = ExperimentResult(todo, results)
    begin("figures and reports")
    write_kept(out / "results.json", result.as_dict())
    write_reports(out, result)
    return result


def n_stages(plan: Plan) -> int:
    """Most calls of ``progress`` by `run`."""
    each = 3 + len(plan.settings) + len(plan.rivals) + len(plan.doubted)
    passes = 2 if plan.jobs > 1 or plan.dask else 1
    return 2 + passes * each * len(plan.patients or patients())


def _wanted(plan: Plan) -> tuple[str, ...]:
    """Names of the patients, each once; `InputError` for an unknown one."""
    everyone = names(scanned=plan.torso is not None)
    for name in plan.patients:
        if name not in everyone:
            raise InputError(
                f"unknown patient {name!r}: choose from {', '.join(everyone)}"
            )
    return tuple(dict.fromkeys(plan.patients)) or everyone


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
    patient: Patient,
    plan: Plan,
    folder: Path,
    todo: tuple[Sequence[Setting], Sequence[str]],
    begin: Callable[[str], None],
) -> PatientResult:
    settings, others = todo
    digest = patient.digest(plan.resolution)
    examination = examine(patient, folder, plan.resolution, begin)
    fits = PatientFits(examination, folder, plan.shape, digest)
    found = {}
    for setting in settings:
        begin(f"{patient.name}: {setting.name}")
        found[setting.name] = fits.fitted(setting)
    begin(f"{patient.name}: boundary values")
    boundary = boundary_errors(fits, plan.weight, folder / "boundary.json", fits.stamp)
    compared_with = []
    for name in others:
        begin(f"{patient.name}: {name}")
        compared_with.append(rivals.rival(fits, name, folder, digest))
    doubts = []
    for setting in plan.doubted:
        begin(f"{patient.name}: doubt of {setting.name}")
        doubts.append(stated_doubt(fits, setting, folder, fits.stamp))
    return PatientResult(
        examination, found, boundary, tuple(compared_with), tuple(doubts), _itself(fits)
    )


def _itself(fits: PatientFits) -> tuple[Row, ...]:
    """Errors of the phantom at the reported poses against measured wrenches."""
    rows = []
    for recording, own in fits.examination.itself.items():
        assert own.force is not None
        assert own.torque is not None
        rendered = as_rendered(np.hstack([own.force, own.torque]))
        errors = compare(fits.examination.measured[recording], rendered)
        rows.append(fits.row(ITSELF, recording, "measured", errors))
    return tuple(rows)
