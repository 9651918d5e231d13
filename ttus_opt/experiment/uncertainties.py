"""Stated uncertainty of a patient's fits against their errors on new trajectories."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ttus_opt.core.errors import InputError
from ttus_opt.core.saved_results import computed_once, restored
from ttus_opt.experiment.boundary import UNSEEN
from ttus_opt.experiment.fits import PatientFits
from ttus_opt.experiment.settings import Setting
from ttus_opt.fitting.uncertainty.field_uncertainty import uncertainty
from ttus_opt.fitting.uncertainty.uncertainty_check import (
    Calibration,
    check_uncertainty,
)
from ttus_opt.problem.solution import Status
from ttus_opt.report.calibration_curve import CalibrationCurve


@dataclass(frozen=True)
class StatedUncertainty:
    """The uncertainty of one setting on one patient.

    Attributes:
        setting: Name.
        figures: Coverage and rank correlation by new recording.
        refused: Why there is none; "" otherwise.
    """

    setting: str
    figures: Mapping[str, Calibration] = field(repr=False)
    refused: str = ""

    @property
    def curves(self) -> dict[str, CalibrationCurve]:
        """The same as curves."""
        found = {name: one.curve for name, one in self.figures.items()}
        return {name: curve for name, curve in found.items() if curve is not None}

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "figures": {name: one.as_dict() for name, one in self.figures.items()},
            "curves": {name: one.as_dict() for name, one in self.curves.items()},
            "refused": self.refused,
        }


def stated_uncertainty(fits: PatientFits, setting: Setting) -> StatedUncertainty:
    """Uncertainty of a setting and its check, computed or from its file.

    Args:
        fits: Fits of the patient.
        setting: The setting.
    """
    return computed_once(
        fits.folder / f"uncertainty-{setting.name}.json",
        {"digest": fits.stamp, "setting": setting.as_dict(), **setting.source},
        lambda: _checked(fits, setting),
        save=StatedUncertainty.as_dict,
        load=lambda content: _read(setting.name, content),
    )


def _checked(fits: PatientFits, setting: Setting) -> StatedUncertainty:
    solution, scene, _ = fits.solved(setting)
    if solution.status is not Status.SOLVED:
        reason = f"the fit ended {solution.status.name.lower()}"
        return StatedUncertainty(setting.name, {}, reason)
    figures = {}
    try:
        stated = uncertainty(solution, scene)
        for name in UNSEEN:
            judged = fits.evaluation(solution.field, name, "measured")
            measured = fits.examination.measured[name]
            figures[name] = check_uncertainty(stated, judged, measured)
    except InputError as error:
        return StatedUncertainty(setting.name, {}, str(error))
    return StatedUncertainty(setting.name, figures)


def _read(name: str, content: Mapping[str, Any]) -> StatedUncertainty:
    curves = {k: CalibrationCurve.from_dict(v) for k, v in content["curves"].items()}
    figures = {
        k: replace(restored(Calibration, v), curve=curves.get(k))
        for k, v in content["figures"].items()
    }
    return StatedUncertainty(name, figures, content["refused"])
