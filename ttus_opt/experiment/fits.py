"""Fits of one patient: a field per setting, evaluated on all recordings, and cached."""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from ttus_opt.contact.scene import Scene, ScenePlan
from ttus_opt.core import io
from ttus_opt.core.errors import NumericalError, TtusWarning, warn
from ttus_opt.core.json_values import plain
from ttus_opt.experiment.patients import PROBE_SPEC
from ttus_opt.experiment.recordings import Examination
from ttus_opt.experiment.scores import Row, Score
from ttus_opt.experiment.settings import GIVEN, Setting
from ttus_opt.fitting.batch import fit
from ttus_opt.fitting.poses.pose_refinement import refine_poses
from ttus_opt.fitting.weights.weight_choice import choice_of
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem.solution import Solution, Status
from ttus_opt.report.metrics import Evaluation, evaluate
from ttus_opt.voxmap.field import PotentialField

#: The recordings to which fields are fitted
FITTED = ("press_fit", "sweep_fit")

#: The wrenches with which a rendering is compared
AGAINST = ("measured", "true")

Kept = TypeVar("Kept")


@dataclass(frozen=True)
class Fitted:
    """A setting fitted to a patient.

    Attributes:
        setting: Name.
        rows: Its errors.
        facts: Status, solver, seconds and identified parameters, for JSON.
        field: The field, None where the fit failed.
    """

    setting: str
    rows: tuple[Row, ...] = field(repr=False)
    facts: Mapping[str, Any]
    field: PotentialField | None = field(repr=False)


class PatientFits:
    """All fits of one patient; scenes are built once.

    Args:
        examination: The patient's recordings.
        folder: Folder for cached fields and errors.
        shape: Voxels in r, θ and z [–].
        digest: Checksum of the input of the recordings.

    Attributes:
        examination: The patient with its recordings.
        shell: The probe.
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
        self._folder, self._shape, self._digest = folder, shape, digest
        self.stamp = f"{digest} {shape}"
        self._scenes: dict[tuple[object, ...], Scene] = {}

    def scene(self, setting: Setting) -> Scene:
        """The scene of a setting over the recordings in `FITTED`."""
        key = setting.scene_key
        if key not in self._scenes:
            plan = ScenePlan(
                self._shape,
                inner=setting.inner,
                outer=setting.outer,
                sampling=setting.sampling,
                boundary=setting.boundary,
            )
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
        """Fit a setting, or read the cached result."""
        file = self._folder / f"{setting.name}.json"
        key = {
            "digest": self._digest,
            "shape": list(self._shape),
            "setting": setting.as_dict(),
            **setting.source,
        }
        kept = read_kept(file, key, lambda found: self._kept(setting, found))
        if kept is not None:
            return kept
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
        found = None
        rows: tuple[Row, ...] = ()
        if solution.status is Status.SOLVED:
            found = solution.field
            found.save(self._folder / f"{setting.name}.nc")
            rows = self.judged(setting.name, found)
        write_kept(
            file, {**key, "facts": facts, "rows": [row.as_dict() for row in rows]}
        )
        return Fitted(setting.name, rows, facts, found)

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

    def judged(self, name: str, found: PotentialField) -> tuple[Row, ...]:
        """Errors of a field on every recording, against measured and true wrenches."""
        rows = []
        for against in AGAINST:
            for recording in getattr(self.examination, against):
                errors = self.evaluation(found, recording, against)
                rows.append(self.row(name, recording, against, errors))
        return tuple(rows)

    def evaluation(
        self, found: PotentialField, recording: str, against: str
    ) -> Evaluation:
        """A field rendered along a recording, compared with its wrenches."""
        own = getattr(self.examination, against)[recording]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", TtusWarning)
            return evaluate(found, self.shell, own)

    def row(self, name: str, recording: str, against: str, errors: Evaluation) -> Row:
        """An evaluation as a row."""
        patient = self.examination.patient.name
        return Row(
            patient, recording, recording in FITTED, name, against, Score.of(errors)
        )

    def _kept(self, setting: Setting, content: Mapping[str, Any]) -> Fitted:
        """A cached result with its field, which exists where there are rows."""
        rows = tuple(Row.from_dict(row) for row in content["rows"])
        file = self._folder / f"{setting.name}.nc"
        found = PotentialField.load(file) if rows else None
        return Fitted(setting.name, rows, content["facts"], found)


def read_kept(
    file: Path, key: Mapping[str, Any], read: Callable[[dict[str, Any]], Kept]
) -> Kept | None:
    """A cached result; None if it is missing, damaged or has another key.

    Args:
        file: The cache.
        key: The input of the result.
        read: Makes the result from the file's content; a `FileError` means that
            another file of it is missing or damaged.
    """
    try:
        kept = json.loads(file.read_text(encoding="utf-8"))
        same = all(kept.get(name) == plain(value) for name, value in key.items())
        return read(kept) if same else None
    except (OSError, ValueError, RecursionError):
        return None
    except (AttributeError, KeyError, TypeError):  # JSON of another shape
        return None


def write_kept(file: Path, content: Mapping[str, Any]) -> None:
    """Write a result, replacing the file only on success."""
    io.write_text(file, json.dumps(plain(content), indent=1, allow_nan=False))
