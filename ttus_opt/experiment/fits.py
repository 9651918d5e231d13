"""Fits of one patient: a field per setting, judged on all recordings, kept in files."""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ttus_opt import io
from ttus_opt.arrays import Array
from ttus_opt.errors import TtusWarning
from ttus_opt.experiment.patients import PROBE_SPEC
from ttus_opt.experiment.recordings import Examination
from ttus_opt.experiment.scores import Row, Score
from ttus_opt.experiment.settings import GIVEN, Setting
from ttus_opt.fitting.batch import fit
from ttus_opt.fitting.weight_words import choice_of
from ttus_opt.haptic.field_wrench import FieldWrenches
from ttus_opt.json_values import plain
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.problem.solution import Status
from ttus_opt.report.metrics import Evaluation, evaluate
from ttus_opt.scene import Scene, ScenePlan
from ttus_opt.voxmap.field import PotentialField

#: The recordings that fields are fitted to
FITTED = ("press_fit", "sweep_fit")

#: What a rendering is held against
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
        folder: Where fields and errors are kept.
        shape: Voxels in r, θ and z [–].
        digest: A word that changes when the recordings would.

    Attributes:
        examination: As given.
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
        """The scene of a setting over the recordings that fields are fitted to."""
        key = setting.scene_key
        if key not in self._scenes:
            plan = ScenePlan(
                self._shape,
                inner=setting.inner,
                outer=setting.outer,
                sampling=setting.sampling,
                boundary=setting.boundary,
            )
            recordings = [self.examination.measured[name] for name in FITTED]
            self._scenes[key] = plan.build(
                self.examination.surface, self.shell, recordings
            )
        return self._scenes[key]

    def fitted(self, setting: Setting) -> Fitted:
        """Fit a setting, or read what an earlier call kept."""
        file = self._folder / f"{setting.name}.json"
        told = {
            "digest": self._digest,
            "shape": list(self._shape),
            "setting": setting.as_dict(),
            **setting.source,
        }
        kept = read_kept(file, told, lambda told: self._kept(setting, told))
        if kept is not None:
            return kept
        begin = time.process_time()
        scene, weights = self.scene(setting), {}
        if setting.weights != GIVEN:
            word, name, options = setting.weights, setting.formulation, setting.options
            choice = choice_of(word, scene, name, options, strict=False)
            solution = fit(choice.scene, choice.formulation)
            told_of_scene = {"sampling": choice.scene.sampling}
            weights = {"weights_chosen": choice.as_dict() | told_of_scene}
        else:
            solution = fit(scene, setting.formulation, **setting.options)
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
            file, {**told, "facts": facts, "rows": [row.as_dict() for row in rows]}
        )
        return Fitted(setting.name, rows, facts, found)

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
        """A field rendered along a recording, beside what stands in it."""
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

    def _kept(self, setting: Setting, told: Mapping[str, Any]) -> Fitted:
        """A kept result with its field, which is there where there are rows."""
        rows = tuple(Row.from_dict(row) for row in told["rows"])
        file = self._folder / f"{setting.name}.nc"
        found = PotentialField.load(file) if rows else None
        return Fitted(setting.name, rows, told["facts"], found)


def as_rendered(wrench: Array) -> FieldWrenches:
    """Wrenches from elsewhere, shape (T, 6) [N, N·m], as `compare` takes them."""
    n = len(wrench)
    within, none = np.ones(n, dtype=bool), np.zeros(n, dtype=np.int64)
    return FieldWrenches(wrench[:, :3], wrench[:, 3:], within, none)


def read_kept(
    file: Path, told: Mapping[str, Any], read: Callable[[dict[str, Any]], Kept]
) -> Kept | None:
    """A kept result, None where there is none of the same making, or it is damaged.

    Args:
        file: Where it is kept.
        told: What it was made of.
        read: Makes it of what the file has; a `FileError` says that another file of it
            is missing or damaged.
    """
    try:
        kept = json.loads(file.read_text(encoding="utf-8"))
        same = all(kept.get(name) == plain(value) for name, value in told.items())
        return read(kept) if same else None
    except (OSError, ValueError, RecursionError):
        return None
    except (AttributeError, KeyError, TypeError):  # JSON of another shape
        return None


def write_kept(file: Path, content: Mapping[str, Any]) -> None:
    """Write a result, replacing the file only on success."""
    io.write_text(file, json.dumps(plain(content), indent=1, allow_nan=False))
