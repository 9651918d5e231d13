"""Fits of one patient: a field per setting, evaluated on all recordings, and saved."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ttus_opt.contact.scene import Scene, ScenePlan
from ttus_opt.core.errors import NumericalError, TtusError, TtusWarning, warn
from ttus_opt.core.saved_results import computed_once, restored
from ttus_opt.experiment.patients import PROBE_SPEC, Examination
from ttus_opt.experiment.settings import GIVEN, Setting
from ttus_opt.fitting.batch import fit
from ttus_opt.fitting.poses.pose_refinement import refine_poses
from ttus_opt.fitting.weights.weight_choice import choice_of
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem.solution import Solution, Status
from ttus_opt.report.metrics import (
    NOTICEABLE_FORCE,
    NOTICEABLE_SHARE,
    Errors,
    Evaluation,
    as_rendered,
    compare,
    evaluate,
)
from ttus_opt.voxmap.field import PotentialField

#: Largest mean angle of force [°], relative error of torque [–] and its angle [°]
AIM_ANGLE, AIM_TORQUE, AIM_TORQUE_ANGLE = 3.0, 0.15, 10.0


def meets(errors: Errors) -> dict[str, bool]:
    """Whether each aim is reached, by name."""
    return {
        "force": errors.force_median_share <= NOTICEABLE_SHARE
        or errors.force_median_N <= NOTICEABLE_FORCE,
        "angle": errors.force_angle_error_deg <= AIM_ANGLE,
        "torque": errors.torque_share <= AIM_TORQUE,
        "torque angle": errors.torque_angle_error_deg <= AIM_TORQUE_ANGLE,
    }


@dataclass(frozen=True)
class Row:
    """One setting on one recording of one patient.

    Attributes:
        patient: Name.
        recording: Name.
        seen: Whether the setting was fitted to it.
        setting: Name.
        against: Reference: ``measured`` (reported poses, noisy wrench) or ``true``
            (true poses, true wrench).
        score: Its errors.
    """

    patient: str
    recording: str
    seen: bool
    setting: str
    against: str
    score: Errors

    def as_dict(self) -> dict[str, Any]:
        """Flat, for JSON."""
        return {**{k: getattr(self, k) for k in _KEYS}, **self.score.as_dict()}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Row:
        """Inverse of `as_dict`."""
        score = {k: v for k, v in values.items() if k not in _KEYS}
        return cls(**{k: values[k] for k in _KEYS}, score=restored(Errors, score))


_KEYS = ("patient", "recording", "seen", "setting", "against")


#: Begins the setting of a comparator's rows
PREFIX = "comparator "

#: The recordings to which fields are fitted
FITTED = ("press_fit", "sweep_fit")

#: The wrenches with which a rendering is compared
AGAINST = ("measured", "true")


@dataclass(frozen=True)
class Fitted:
    """A setting, or a comparator, fitted to a patient.

    Attributes:
        name: Of the setting or comparator.
        rows: Its errors; none where the fit failed.
        facts: Status, solver, seconds and identified parameters, for JSON; of a
            comparator processor seconds, milliseconds per frame and ripple, or the
            failure.
        field: The field; None of a comparator, and where the fit failed.
    """

    name: str
    rows: tuple[Row, ...] = field(repr=False)
    facts: Mapping[str, Any]
    field: PotentialField | None = field(default=None, repr=False)

    @classmethod
    def once(
        cls,
        name: str,
        file: Path,
        inputs: Mapping[str, Any],
        compute: Callable[[], Fitted],
    ) -> Fitted:
        """From its file, and its field's beside it where there is one, or computed."""

        def load(content: dict[str, Any]) -> Fitted:
            rows = tuple(Row.from_dict(row) for row in content["rows"])
            beside = file.with_suffix(".nc")
            has_field = bool(rows) and "setting" in inputs
            field = PotentialField.load(beside) if has_field else None
            return cls(name, rows, content["facts"], field)

        done: Fitted = computed_once(
            file,
            inputs,
            compute,
            save=lambda done: {
                "facts": done.facts,
                "rows": [row.as_dict() for row in done.rows],
            },
            load=load,
        )
        return done


class PatientFits:
    """All fits of one patient; scenes are built once.

    Args:
        examination: The patient's recordings.
        folder: Folder for fields and errors.
        shape: Voxels in r, θ and z [–].
        digest: Checksum of the input of the recordings.

    Attributes:
        examination: The patient with its recordings.
        shell: The probe.
        folder: As given.
        digest: As given.
        stamp: Digest and shape in one.
    """

    def __init__(
        self,
        examination: Examination,
        folder: Path,
        shape: tuple[int, int, int],
        digest: str,
    ) -> None:
        self.examination = examination
        self.shell = PointShell.from_spec(PROBE_SPEC)
        self.folder, self._shape, self.digest = folder, shape, digest
        self.stamp = f"{digest} {shape}"
        self._scenes: dict[tuple[ScenePlan, bool], Scene] = {}

    def scene(self, setting: Setting) -> Scene:
        """The scene of a setting over the recordings in `FITTED`."""
        key = setting.plan, setting.refined
        if key not in self._scenes:
            plan = replace(setting.plan, shape=self._shape)
            recorded = self._refined if setting.refined else self._recorded
            surface = self.examination.surface
            self._scenes[key] = plan.build(surface, self.shell, recorded)
        return self._scenes[key]

    @property
    def _recorded(self) -> list[Trajectory]:
        return [self.examination.measured[name] for name in FITTED]

    @cached_property
    def _refined(self) -> list[Trajectory]:
        """The fitted recordings with refined poses."""
        plan = ScenePlan(self._shape)
        scene = plan.build(self.examination.surface, self.shell, self._recorded)
        try:
            return refine_poses(scene).recordings
        except NumericalError as error:
            warn(f"poses are not refined: {error}")
            return self._recorded

    def fitted(self, setting: Setting) -> Fitted:
        """Fit a setting, or read the saved result."""
        inputs = {
            "digest": self.digest,
            "shape": list(self._shape),
            "setting": setting.as_dict(),
            **setting.source,
        }
        file = self.folder / f"{setting.name}.json"
        return Fitted.once(setting.name, file, inputs, lambda: self._fitted(setting))

    def _fitted(self, setting: Setting) -> Fitted:
        begin = time.process_time()
        solution, _, weights = self.solved(setting)
        facts: dict[str, Any] = {
            "status": solution.status.name.lower(),
            "solver": solution.solver,
            "formulation": solution.formulation,
            "processor_seconds": round(time.process_time() - begin, 2),
            "parameters": dict(solution.parameters),
            "not_identified": dict(solution.not_identified),
            **weights,
        }
        if solution.status is not Status.SOLVED:
            return Fitted(setting.name, (), facts)
        solution.field.save(self.folder / f"{setting.name}.nc")
        rows = self.judged(setting.name, solution.field)
        return Fitted(setting.name, rows, facts, solution.field)

    def solved(self, setting: Setting) -> tuple[Solution, Scene, dict[str, Any]]:
        """Fit a setting: the solution, its scene, and how weights were chosen."""
        scene = self.scene(setting)
        if setting.weights == GIVEN:
            solution = fit(scene, setting.formulation, **setting.options)
            return solution, scene, {}
        word, name, options = setting.weights, setting.formulation, setting.options
        choice = choice_of(word, scene, name, options, strict=False)
        told = choice.as_dict() | {"sampling": choice.scene.sampling}
        solution = fit(choice.scene, choice.formulation)
        return solution, choice.scene, {"weights_chosen": told}

    def judged(self, name: str, field: PotentialField) -> tuple[Row, ...]:
        """Errors of a field on every recording, against measured and true wrenches."""
        rows = []
        for against in AGAINST:
            for recording in getattr(self.examination, against):
                errors = self.evaluation(field, recording, against)
                rows.append(self.row(name, recording, against, errors))
        return tuple(rows)

    def evaluation(
        self, field: PotentialField, recording: str, against: str
    ) -> Evaluation:
        """A field rendered along a recording, compared with its wrenches."""
        recorded = getattr(self.examination, against)[recording]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", TtusWarning)
            return evaluate(field, self.shell, recorded)

    def row(self, name: str, recording: str, against: str, errors: Evaluation) -> Row:
        """An evaluation as a row."""
        patient = self.examination.patient.name
        return Row(
            patient, recording, recording in FITTED, name, against, errors.errors
        )

    def rival(self, name: str) -> Fitted:
        """Fit and judge one of `ttus_opt.comparators`, or read the saved result."""
        inputs = {"digest": self.digest, "rival": name}
        file = self.folder / f"rival-{name}.json"
        return Fitted.once(name, file, inputs, lambda: self._rival(name))

    def _rival(self, name: str) -> Fitted:
        from ttus_opt.comparators import create
        from ttus_opt.comparators.comparison import ripple, timed_wrenches

        examined = self.examination
        begin = time.process_time()
        try:
            model = create(
                name,
                surface=examined.surface,
                shell=self.shell,
            )
            model.fit([examined.measured[recording] for recording in FITTED])
        except TtusError as error:
            return Fitted(name, (), {"failure": str(error)})
        spent = time.process_time() - begin
        rows: list[Row] = []
        per_frame = []
        for against in AGAINST:
            for recording, recorded in getattr(examined, against).items():
                wrench, frame = timed_wrenches(model, recorded)
                per_frame.append(frame)
                errors = compare(recorded, as_rendered(wrench))
                rows.append(self.row(PREFIX + name, recording, against, errors))
        facts = {
            "ms_per_frame": 1e3 * float(np.median(per_frame)),
            "ripple": ripple(model, examined.true["sweep_test"]),
            "processor_seconds": round(spent, 2),
        }
        return Fitted(name, tuple(rows), facts)
