"""Results that are kept: taken when they are of the same making, else made anew.

Fits to refined poses take refined recordings, and are judged at reported ones.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.kit import presses, refuses, torso
from ttus_opt.core.saved_results import write_json
from ttus_opt.experiment import fits
from ttus_opt.experiment import patients as phantoms
from ttus_opt.experiment.boundary import boundary_errors
from ttus_opt.experiment.fits import FITTED, PatientFits, Row, meets
from ttus_opt.experiment.patients import patients
from ttus_opt.experiment.settings import BY_DEFAULT, LAPLACE, REFINED, Setting
from ttus_opt.haptic.field_wrench import FieldWrenches
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.report.metrics import Errors, compare


class BegunError(Exception):
    """The work is done again."""


def begin(*_, **__):
    raise BegunError


@pytest.fixture
def judge(tmp_path, monkeypatch):
    """Knows what it was given, and cannot fit."""
    monkeypatch.setattr(PatientFits, "scene", begin)
    no_shell = SimpleNamespace(from_spec=lambda spec: None)
    monkeypatch.setattr("ttus_opt.experiment.fits.PointShell", no_shell)
    examination = SimpleNamespace(patient=patients()[0])
    return PatientFits(examination, tmp_path, (8, 16, 8), "digest")


SCORE = Errors(*19 * [1.0])
ROW = Row("lean", "press_test", False, LAPLACE.name, "true", SCORE).as_dict()


@pytest.mark.parametrize("rows", [[ROW], [{}], [1], {}, None, "rows"])
def test_a_result_of_another_shape_or_without_its_field_is_made_anew(
    tmp_path, judge, rows
):
    told = {"digest": "digest", "shape": [8, 16, 8], "setting": LAPLACE.as_dict()}
    kept = {**told, "facts": {}, "rows": rows}
    write_json(tmp_path / "laplace_scaled.json", kept)
    if rows == {}:  # a fit that failed has no rows, and is not tried again
        assert judge.fitted(LAPLACE).field is None
        return
    refuses(BegunError, "", judge.fitted, LAPLACE)


def test_boundary_values_and_comparators_of_another_shape_are_made_anew(
    tmp_path, judge, monkeypatch
):
    factors = [10.0**k for k in (-0.5, -0.25, 0.0, 0.25, 0.5)]
    told = {"digest": judge.stamp, "weight": 1.0, "factors": factors}
    file = tmp_path / "boundary.json"
    write_json(file, {**told, "rows": [{"patient": "lean"}]})
    refuses(BegunError, "", boundary_errors, judge, 1.0)
    kept = {"digest": "digest", "rival": "kelvin_voigt", "rows": [{}], "facts": {}}
    write_json(tmp_path / "rival-kelvin_voigt.json", kept)
    monkeypatch.setattr(judge, "_rival", begin)
    refuses(BegunError, "", judge.rival, "kelvin_voigt")


def test_an_edited_file_of_ones_own_is_fitted_again(tmp_path, judge):
    own = tmp_path / "mine.py"
    own.write_text("one = 1\n")
    setting = Setting("mine", str(own))
    told = {"digest": "digest", "shape": [8, 16, 8], "setting": setting.as_dict()}
    kept = {**told, **setting.source, "facts": {}, "rows": []}
    write_json(tmp_path / "mine.json", kept)
    assert judge.fitted(setting).rows == ()
    own.write_text("one = 2\n")
    refuses(BegunError, "", judge.fitted, setting)
    assert LAPLACE.source == {}


def test_recordings_of_two_makings_are_never_mixed(tmp_path, monkeypatch):
    patient = SimpleNamespace(name="lean", digest=str)
    patient.surface = lambda: SimpleNamespace(save=lambda file: None)
    stamp = tmp_path / "digest.txt"
    stamp.write_text(patient.digest(3.0))
    for name in phantoms.FILES:
        (tmp_path / name).touch()
    monkeypatch.setattr(phantoms, "_skin", lambda *_: None)
    monkeypatch.setattr(phantoms, "_record", begin)
    with pytest.raises(BegunError):  # interrupted while the first is written
        phantoms.examine(patient, tmp_path, 2.0)
    assert not stamp.exists()
    stamp.write_text(patient.digest(3.0))
    (tmp_path / "sweep_test_true.csv").unlink()
    refuses(BegunError, "", phantoms.examine, patient, tmp_path, 3.0)


def test_only_the_fitted_recordings_are_refined(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    recorded = {name: presses(torso(), 4, rng) for name in (*FITTED, "press_test")}
    refined = [presses(torso(), 4, rng) for _ in FITTED]
    given = []

    def refine(scene):
        given.append(scene)
        return SimpleNamespace(recordings=refined)

    monkeypatch.setattr(fits, "refine_poses", refine)
    examination = SimpleNamespace(measured=recorded, surface=torso())
    each = PatientFits(examination, tmp_path, (10, 24, 14), "")
    for _ in range(2):  # once for all settings
        found = each.scene(REFINED).trajectory.position
        np.testing.assert_array_equal(
            found, np.concatenate([one.position for one in refined])
        )
    reported = np.concatenate([recorded[name].position for name in FITTED])
    np.testing.assert_array_equal(each.scene(BY_DEFAULT).trajectory.position, reported)
    (scene,) = given
    np.testing.assert_array_equal(scene.trajectory.position, reported)


def evaluation(factor, n=100, force=5.0, torque=0.05):
    """Every frame rendered at a factor of its own."""
    up = np.tile([0.0, force, 0.0], (n, 1))
    turn = np.tile([torque, 0.0, 0.0], (n, 1))
    own = Trajectory(
        np.arange(n) / 20, np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)), up, turn
    )
    factor = np.broadcast_to(factor, n)[:, None]
    rendered = FieldWrenches(
        factor * up, factor * turn, np.ones(n, bool), np.zeros(n, np.int64)
    )
    return compare(own, rendered)


def row(judged):
    return Row("lean", "press_test", False, "eq10", "true", judged.errors)


def test_medians_shares_and_the_worst_five_per_cent():
    factor = np.ones(100)
    factor[:60] = 1.05
    factor[-6:] = 1.5
    score = evaluation(factor).errors
    assert score.force_median_share == pytest.approx(0.05)
    assert score.force_median_N == pytest.approx(0.25)
    assert score.force_worst_N == pytest.approx(2.5)
    assert score.force_magnitude_error_N == pytest.approx(0.6 * 0.25 + 0.06 * 2.5)
    assert score.torque_share == pytest.approx(0.6 * 0.05 + 0.06 * 0.5)
    assert score.share_told_apart == pytest.approx(0.06)
    assert score.mean_force_N == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("factor", "met"), [(1.06, True), (1.08, False), (1.16, False)]
)
def test_aims(factor, met):
    aims = meets(row(evaluation(factor)).score)
    assert aims["force"] is met
    assert aims["torque"] is (factor < 1.15)
    assert aims["angle"] and aims["torque angle"]


def test_nothing_is_met_where_nothing_touches_and_rows_survive_json():
    one = row(evaluation(1.0, force=0.1))
    assert np.isnan(one.score.force_median_N) and one.score.frames_in_contact == 0
    assert not any(meets(one.score).values())
    told = {k: None if v != v else v for k, v in one.as_dict().items()}
    assert Row.from_dict(told).as_dict() == pytest.approx(one.as_dict(), nan_ok=True)
