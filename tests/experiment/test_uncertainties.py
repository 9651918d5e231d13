"""Stated uncertainty of a patient: what is kept comes back, and why there is none."""

from types import SimpleNamespace

import numpy as np
import pytest

from ttus_opt.core.errors import InputError
from ttus_opt.experiment import uncertainties
from ttus_opt.experiment.settings import AUTO, Setting
from ttus_opt.experiment.uncertainties import stated_uncertainty
from ttus_opt.fitting.uncertainty.uncertainty_check import Calibration
from ttus_opt.problem.solution import Status
from ttus_opt.report.calibration_curve import CalibrationCurve

SETTING = Setting("eq10_auto", "eq10", weights=AUTO)


def fits(folder, stamp, status=Status.SOLVED):
    solution = SimpleNamespace(status=status, field=None)
    return SimpleNamespace(
        folder=folder,
        stamp=stamp,
        solved=lambda setting: (solution, None, {}),
        evaluation=lambda field, name, against: None,
        examination=SimpleNamespace(measured={"press_test": None, "sweep_test": None}),
    )


def test_what_is_kept_comes_back(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    curve = CalibrationCurve.of((rng.standard_normal((20, 3)), np.ones((20, 3))))
    nan = float("nan")
    figures = Calibration(0.1, nan, 0.95, nan, 0.3, nan, 20, curve=curve)
    monkeypatch.setattr(uncertainties, "uncertainty", lambda *_: None)
    monkeypatch.setattr(uncertainties, "check_uncertainty", lambda *_: figures)
    made = stated_uncertainty(fits(tmp_path, "word"), SETTING)
    monkeypatch.setattr(uncertainties, "uncertainty", None)
    again = stated_uncertainty(fits(tmp_path, "word"), SETTING)
    assert list(again.figures) == list(made.figures) == ["press_test", "sweep_test"]
    for one in again.figures.values():
        assert one.force_coverage == 0.95 and np.isnan(one.torque_coverage)
    np.testing.assert_array_equal(again.curves["press_test"].force, curve.force)
    with pytest.raises(TypeError):  # another input is computed, not read
        stated_uncertainty(fits(tmp_path, "another word"), SETTING)


def test_a_refusal_and_a_failed_fit_are_told(tmp_path, monkeypatch):
    def refuse(*_):
        raise InputError("no uncertainty for viscous_drag: …")

    monkeypatch.setattr(uncertainties, "uncertainty", refuse)
    assert stated_uncertainty(fits(tmp_path, "a"), SETTING).refused.startswith(
        "no uncertainty"
    )
    failed = stated_uncertainty(fits(tmp_path, "b", Status.TIME_LIMIT), SETTING)
    assert failed.refused == "the fit ended time_limit"
    assert not failed.figures and not failed.curves
