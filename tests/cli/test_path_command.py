"""``ttus-opt path``: what it writes, tells and refuses."""

import numpy as np
import pytest

import ttus_opt as tt
from tests.cli.conftest import PROBE, scene_words
from ttus_opt.fitting.path import solution_path


def words(files, output, more=""):
    own = f"{scene_words(files)} --held-out {files / 'press.csv'}"
    return f"path {own} --inner fit --sampling trilinear -o {output} {more}"


@pytest.mark.slow
def test_it_writes_a_file_and_a_picture_and_tells(run, files, tmp_path):
    output, picture = tmp_path / "path.nc", tmp_path / "path.png"
    more = f"--weight force,torque=1e-3:10:3 --criteria --fields --picture {picture}"
    told = run(words(files, output, f"{more} --json")).told
    assert told["points"] == told["points_done"] == told["points_solved"] == 3
    assert told["solver"] == "structured" and told["worst_kkt"] < 1e-6
    found = tt.read_solution_path(output)
    assert found.attrs["probe"] == PROBE
    assert found["recording"].values.tolist() == ["press"]
    np.testing.assert_allclose(found["force_weight"], [1e-3, 0.1, 10.0])
    error = told["variables"]["held_out_force_magnitude_error"]
    assert error["units"] == "N"
    np.testing.assert_allclose(error["values"], found["held_out_force_magnitude_error"])
    assert found["potential"].shape == (3, 10, 16, 8)
    assert np.isfinite(told["variables"]["log_evidence"]["values"]).all()
    assert picture.read_bytes().startswith(b"\x89PNG")
    best = told["best_weights"]["force"]
    plain = run(words(files, output, more))
    assert "3 of 3 points solved by structured" in plain.out
    assert f"force weight {best:.3g}" in plain.out


@pytest.mark.parametrize("done", [2, 0])
def test_an_interrupt_writes_what_is_done(run, files, tmp_path, monkeypatch, done):
    from ttus_opt.fitting.path import solution_path as module

    plain = module.PathRecord.add
    count = 0

    def add(*given):
        nonlocal count
        count += 1
        if count == done + 1:
            raise KeyboardInterrupt
        plain(*given)

    monkeypatch.setattr(module.PathRecord, "add", add)
    output = tmp_path / "path.nc"
    answer = run(words(files, output, "--weight force=1e-2:1:4"))
    assert answer.status == 130
    if not done:
        assert not output.exists()
        return
    assert "interrupted after 2 of 4 points" in answer.err
    assert int((tt.read_solution_path(output)["status"] == 0).sum()) == 2
    monkeypatch.setattr(module.PathRecord, "add", plain)
    answer = run(words(files, output, "--weight force=1e-2:1:4"))
    assert answer.status == 0 and "going on from 2 of 4 points" in answer.err
    found = tt.read_solution_path(output)
    assert (found["status"] == 0).all() and found.attrs["probe"] == PROBE
    answer = run(words(files, output, "--weight force=1e-2:1:3 --jobs 2"))
    assert f"{output} holds a path of other inputs (weights): " in answer.err
    assert "jobs and dask are not used" in answer.err
    assert tt.read_solution_path(output)["status"].shape == (3,)


def test_nothing_solved_is_status_one(run, files, tmp_path, monkeypatch):
    """The file is written, for its residuals."""
    traced = solution_path.solution_path

    def unsolved(*given, **named):
        found = traced(*given, **named)
        found["status"][:] = 1
        return found

    monkeypatch.setattr(solution_path, "solution_path", unsolved)
    output = tmp_path / "path.nc"
    answer = run(words(files, output, "--weight force,torque=0.1,1"))
    assert answer.status == 1
    assert "error: no point was solved: see residuals in" in answer.err
    assert output.exists()


def test_a_list_of_weights_is_positive():
    from ttus_opt.cli.path_command import _values

    found = _values("0.5,2")
    assert found.tolist() == [0.5, 2.0]
    for text in ("0,1", "1,inf", "-1,2", "1,x"):
        assert _values(text) is None
