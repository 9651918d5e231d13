"""``ttus-opt refine-poses``: what it writes, tells and refuses."""

import numpy as np
import pytest

import ttus_opt as tt
from tests.cli.conftest import refused, scene_words
from ttus_opt.fitting.poses import pose_refinement
from ttus_opt.fitting.poses.pose_error_step import Check


def words(files, output, more=""):
    return f"refine-poses {scene_words(files, '8,12,6', 100)} -o {output} {more}"


@pytest.mark.slow
def test_it_writes_recordings_for_fit(run, files, tmp_path, monkeypatch):
    monkeypatch.setattr(pose_refinement, "CONVERGED", np.inf)
    monkeypatch.setattr(pose_refinement, "LEAST_GAIN", -np.inf)
    monkeypatch.setattr(Check, "better", True)
    output = tmp_path / "refined.csv"
    told = run(words(files, output, "--json --position-noise 0.3 --correlation 2")).told
    (one,) = told["recordings"]
    given, found = (tt.read_trajectory(path) for path in (files / "press.csv", output))
    assert told["frames"] == len(found) == len(given)
    moved = 1e3 * (found.position - given.position)
    assert 0.0 < one["position_mm"] < 0.6
    assert np.sqrt(np.mean(moved**2)) == pytest.approx(one["position_mm"], rel=1e-4)
    assert 0.0 < one["position_std_mm"] < 0.3
    plain = run(words(files, output, "--position-noise 0.3 --correlation 2"))
    assert f"poses moved by {one['position_mm']:.2f} mm" in plain.out


def test_forces_without_a_field_move_no_pose(run, files, tmp_path):
    output = tmp_path / "refined.csv"
    answer = run(words(files, output))
    assert answer.status == 0
    assert "the poses are left as reported" in " ".join(answer.errors)
    given, found = (tt.read_trajectory(path) for path in (files / "press.csv", output))
    np.testing.assert_allclose(found.position, given.position, atol=1e-9)


def test_steps_that_do_not_end_write_nothing(run, files, tmp_path, monkeypatch):
    monkeypatch.setattr(pose_refinement, "CONVERGED", 0.0)
    monkeypatch.setattr(pose_refinement, "LEAST_GAIN", -np.inf)
    monkeypatch.setattr(pose_refinement, "MOST_STEPS", 3)
    output = tmp_path / "refined.csv"
    answer = run(words(files, output))
    assert answer.status == 1
    assert answer.out == ""
    assert answer.errors[-1].startswith("error: refined poses still move by")
    assert not output.exists()


def test_it_does_not_replace_its_input(run, files):
    refused(run(words(files, files / "press.csv")), "press.csv")
