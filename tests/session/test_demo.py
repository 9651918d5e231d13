"""The demo on a coarse grid; the full one is the README's command."""

import json

import numpy as np
import pytest

import ttus_opt as tt
from ttus_opt.session import demo


@pytest.fixture(scope="module")
def stages():
    return []


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("demo")


@pytest.fixture(scope="module")
def result(folder, stages):
    return demo.run(folder, shape=(16, 40, 16), progress=stages.append)


def test_both_fits_hold_their_own_check(result):
    assert result.before.status is tt.Status.SOLVED
    assert result.after.status is tt.Status.SOLVED
    assert result.after.formulation == "eq10"


def test_measurements_lower_the_errors_of_unseen_motion(result):
    unseen = [case for case in result.comparisons if not case.seen]
    assert [case.recording for case in unseen] == ["press_test", "sweep_test"]
    for case in unseen:
        before, after = case.before.errors, case.after.errors
        assert after.force_magnitude_error_N < before.force_magnitude_error_N
        assert after.force_angle_error_deg < before.force_angle_error_deg


def test_the_scan_gives_the_true_skin(result):
    assert result.surface_error.mean < 2e-3
    assert result.surface_error.p95 < 5e-3
    assert 0.3 < result.surface_error.observed < 0.8


def test_every_file_is_there_and_readable(result, folder):
    written = {path.name for path in folder.iterdir()}
    assert written == {
        *demo.PICTURES,
        "surface.nc",
        "field.nc",
        "report.md",
        "report.html",
    }
    field = tt.PotentialField.load(folder / "field.nc")
    np.testing.assert_array_equal(field.values, result.after.field.values)
    surface = tt.Surface.load(folder / "surface.nc")
    np.testing.assert_array_equal(surface.radius, field.voxmap.surface.radius)
    report = (folder / "report.md").read_text(encoding="utf-8")
    assert all(f"({name})" in report for name in demo.PICTURES)
    for name in demo.PICTURES:
        picture = (folder / name).read_bytes()
        assert picture.startswith(b"\x89PNG") and 2_000 < len(picture) < 300_000


def test_progress_is_told_as_often_as_announced(result, stages):
    assert len(stages) == demo.N_STAGES == len(set(stages))


def test_figures_go_into_json(result):
    told = json.loads(json.dumps(result.as_dict()))
    assert told["status"] == "solved"
    assert [row["seen"] for row in told["errors"]] == [True, True, False, False]


def test_fitted_and_unseen_recordings_differ():
    from ttus_opt import example

    poses = [
        tt.read_trajectory(example.path(f"{name}.csv")).position
        for name in (*demo.FITTED, *demo.UNSEEN)
    ]
    for i in range(2):
        shared = np.abs(poses[i] - poses[i + 2]).max(axis=1) < 1e-4
        assert shared.mean() < 0.1
