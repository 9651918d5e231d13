"""``ttus-opt tune`` and ``fit --weights auto``: what they tell and refuse."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import ttus_opt as tt
from tests.cli.conftest import scene_words
from ttus_opt import example
from ttus_opt.cli import tune_command


def words(files, command, more=""):
    return f"{command} {scene_words(files)} {more}"


@pytest.mark.slow
def test_it_tells_weights_and_how_fit_takes_them(run, files, tmp_path):
    told = run(words(files, "tune", "--formulation eq10 --json")).told
    assert told["formulation"] == "eq10"
    error = told["candidates_left_out_force_error_N"]
    assert error == {"eq10": told["left_out_force_error_N"]}
    assert set(told["weights"]) == {"force", "torque"}
    plain = run(words(files, "tune", "--formulation eq10"))
    assert plain.out.splitlines()[-1] == f"ttus-opt fit {told['fit_options']}"
    for name in told["not_determined"]:
        (line,) = (x for x in plain.out.splitlines() if x.startswith(f"{name}: "))
        assert line.endswith(", not determined by the recordings")
    by_hand, by_itself = tmp_path / "hand.nc", tmp_path / "auto.nc"
    assert run(words(files, "fit", f"{told['fit_options']} -o {by_hand}")).status == 0
    fitted = run(
        words(files, "fit", f"--formulation eq10 --weights auto -o {by_itself} --json")
    ).told
    for name, weight in told["weights"].items():  # to the accuracy of the search
        assert fitted["weights"][name] == pytest.approx(weight, rel=1e-3)
    one, other = (tt.PotentialField.load(p).values for p in (by_hand, by_itself))
    assert abs(one - other).max() < 1e-3 * abs(other).max()


@pytest.mark.parametrize("command", ["tune", "evaluate"])
def test_a_wrong_sign_is_told_with_its_option(run, tmp_path, command):
    """As by ``fit``."""
    press = tt.read_trajectory(example.path("press_fit.csv")).select(slice(0, 120))
    press.save(tmp_path / "right.csv")
    replace(press, force=-press.force, torque=-press.torque).save(tmp_path / "w.csv")
    given = f"--surface {example.path('surface.nc')} --shape 12,30,12 --inner 5"
    shared = f"--probe {example.PROBE} --points 200 --trajectory {tmp_path}"
    if command == "evaluate":
        field = tmp_path / "field.nc"
        assert (
            run(f"fit {given} {shared}/right.csv --weights own -o {field}").status == 0
        )
        given = f"--field {field}"
    else:
        given += " --formulation eq10"
    told = run(f"{command} {given} {shared}/w.csv")
    assert told.status == 0, told.err
    assert "forces of the opposite sign?" in told.err
    assert "read them with --flip-wrench" in told.err
    assert "opposite" not in run(f"{command} {given} {shared}/w.csv --flip-wrench").err


def test_models_that_were_not_chosen_are_told_with_their_errors():
    chosen = SimpleNamespace(
        formulation=SimpleNamespace(name="b"),
        candidates={"a": 2.0, "b": 1.0, "c": 3.0},
        weights={},
        scene=SimpleNamespace(inner=1.0, outer=1.0),
        shape=(1, 1, 1),
        hyperparameters=(),
        comparisons=(),
        seconds=1.0,
        noise=1.0,
        left_out_force_error=1.0,
    )
    told = [line.split(":")[0] for line in tune_command._lines(chosen)]
    assert told[:4] == ["b", "a", "c", "error of a force component"]


def test_weights_that_fit_would_not_choose_are_said_to_be_so(run, files, tmp_path):
    press = tt.read_trajectory(files / "press.csv")
    firm = int(np.linalg.norm(press.force, axis=1).argmax())
    press.select(slice(firm, firm + 1)).save(tmp_path / "one.csv")
    (tmp_path / "surface.nc").symlink_to(files / "surface.nc")
    more = "--formulation eq10"
    answer = run(words(tmp_path, "tune", more).replace("press.csv", "one.csv"))
    assert answer.status == 0, answer.err
    assert "fit would not choose these weights: frames in contact: 1" in answer.err
