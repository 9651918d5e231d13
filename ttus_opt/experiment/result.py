"""Plan and results of the experiment."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from ttus_opt.core.arguments import chosen as named
from ttus_opt.core.errors import InputError
from ttus_opt.experiment.boundary import BoundaryError
from ttus_opt.experiment.fits import Fitted, Row
from ttus_opt.experiment.patients import Examination, Patient
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
from ttus_opt.experiment.uncertainties import StatedUncertainty
from ttus_opt.fitting.weights.weight_choice import checked_word
from ttus_opt.problem.formulation import LARGEST
from ttus_opt.voxmap.grid import CylindricalGrid
from ttus_opt.voxmap.voxmap import check_memory

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
        uncertainty: Also check the stated uncertainty of fits whose weights come from
            the recordings.
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
    uncertainty: bool = False
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
        usual = (PAPER_WITHOUT, PAPER_WITH, LAPLACE, without_torque(self.weight), *eq10)
        further = [each for each in others if each not in usual]
        more = chosen(self.formulations, self.weights)
        return distinct((*usual, *further, *more, *(REFINED,) * self.refine))

    @property
    def with_uncertainty(self) -> tuple[Setting, ...]:
        """Settings whose uncertainty is checked: weights come from the recordings."""
        settings = compared(self.formulations, self.weight)
        itself = [each for each in settings if not each.options]
        return (*itself, *chosen(self.formulations, self.weights)) * self.uncertainty

    @property
    def rivals(self) -> tuple[str, ...]:
        """Names of the comparators; `InputError` for an unknown one."""
        if not self.comparators:
            return ()
        from ttus_opt.comparators import available

        return named(self.comparators, available(), "comparator")


@dataclass(frozen=True)
class PatientResult:
    """Results of one patient.

    Attributes:
        examination: The recordings.
        fits: A fit per setting, by name.
        boundary: Errors over a decade of boundary values.
        rivals: The comparators.
        uncertainties: Stated uncertainty, of the settings where it was asked for.
        itself: Rows of the phantom's own wrench at the reported poses.
    """

    examination: Examination
    fits: dict[str, Fitted] = field(repr=False)
    boundary: tuple[BoundaryError, ...] = field(repr=False)
    rivals: tuple[Fitted, ...] = field(repr=False)
    uncertainties: tuple[StatedUncertainty, ...] = field(repr=False)
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
                    "uncertainty": {d.setting: d.as_dict() for d in each.uncertainties},
                }
                for each in self.patients
            },
            "shape": list(self.plan.shape),
            "weight": self.plan.weight,
            "resolution": self.plan.resolution,
            "rows": [row.as_dict() for row in self.rows],
            "boundary": [asdict(row) for row in self.boundary],
        }
