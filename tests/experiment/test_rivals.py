"""Comparators by name, what they are fitted to and judged on, and what is kept."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.kit import InputError, TtusError, presses, torso
from ttus_opt import comparators
from ttus_opt.experiment.fits import PREFIX, PatientFits
from ttus_opt.experiment.result import Plan
from ttus_opt.probe.trajectory import Trajectory

RECORDINGS = ("press_fit", "sweep_fit", "press_test", "sweep_test")


def test_names_of_comparators():
    assert Plan().rivals == ()
    assert Plan(comparators=("all",)).rivals == tuple(comparators.available())
    with pytest.raises(InputError, match="unknown comparator 'kelvin': choose from"):
        _ = Plan(comparators=("all", "kelvin")).rivals


def recordings(seed):
    rng = np.random.default_rng(seed)
    return {name: presses(torso(), 12, rng) for name in RECORDINGS}


class Share:
    """Renders a share of the force that was measured at a pose, 1 N elsewhere."""

    def __init__(self, share, known):
        self._share, self._known = share, known
        self.fitted: list[Trajectory] = []

    def fit(self, given):
        self.fitted = given

    def wrenches(self, own):
        wrench = np.tile([1.0, 0, 0, 0, 0, 0], (len(own), 1))
        if any(own is each for each in self._known):
            wrench[:, :3] = self._share * own.force
        return wrench


@pytest.fixture
def patient(tmp_path, monkeypatch):
    """A patient's fits, with recordings and a comparator of no physics."""
    measured, true = recordings(0), recordings(1)
    examination = SimpleNamespace(
        patient=SimpleNamespace(name="lean"),
        surface=torso(),
        measured=measured,
        true=true,
    )
    fits = PatientFits(examination, tmp_path, (4, 8, 4), "digest")
    fits.made = []

    def create(name, **_):
        if name == "cannot":
            raise TtusError("no sliding in these recordings")
        fits.made.append(Share(0.8, [*measured.values(), *true.values()]))
        return fits.made[-1]

    monkeypatch.setattr(comparators, "create", create)
    return fits


def test_it_is_fitted_to_what_was_measured_and_judged_on_everything(patient):
    found = patient.rival("share")
    measured, true = patient.examination.measured, patient.examination.true
    (model,) = patient.made
    assert len(model.fitted) == 2
    assert model.fitted[0] is measured["press_fit"]
    assert model.fitted[1] is measured["sweep_fit"]
    told = {(row.against, row.recording): row for row in found.rows}
    assert len(told) == len(found.rows) == 8
    for against, by_name in (("measured", measured), ("true", true)):
        for name, own in by_name.items():
            row = told[against, name]
            assert (row.patient, row.setting) == ("lean", PREFIX + "share")
            assert row.seen == (name in ("press_fit", "sweep_fit"))
            size = np.linalg.norm(own.force, axis=1)
            error = row.score.force_magnitude_error_N
            assert error == pytest.approx(0.2 * size.mean())
            assert row.score.force_angle_error_deg == pytest.approx(0.0, abs=1e-5)
    assert found.facts["ripple"] == pytest.approx(0.0, abs=1e-12)  # 1 N all along
    assert found.facts["ms_per_frame"] >= 0.0
    assert found.facts["processor_seconds"] >= 0.0


def test_what_was_found_is_kept(patient):
    """Until the recordings are others."""
    first, again = patient.rival("share"), patient.rival("share")
    assert len(patient.made) == 1
    assert again.facts == first.facts and repr(again.rows) == repr(first.rows)
    patient.digest = "another"
    patient.rival("share")
    assert len(patient.made) == 2


def test_one_that_cannot_be_fitted_has_its_reason(patient):
    for _ in range(2):  # found, and kept
        found = patient.rival("cannot")
        assert found.rows == ()
        assert found.facts == {"failure": "no sliding in these recordings"}
