"""Fits to refined poses take refined recordings, and are judged at reported ones."""

from types import SimpleNamespace

import numpy as np

from tests.conftest import presses, torso
from ttus_opt.experiment import fits
from ttus_opt.experiment.fits import FITTED, PatientFits
from ttus_opt.experiment.settings import BY_DEFAULT, REFINED


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
