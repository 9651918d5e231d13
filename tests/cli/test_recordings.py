"""A laboratory's recording, written by ROS's conventions, through the commands."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from ttus_opt import example
from ttus_opt.cli.evaluate_command import warn_of_poses
from ttus_opt.core.errors import MistakeWarning
from ttus_opt.probe.trajectory import read_trajectory

NAMES = {
    **{f"p{c}": f"/robot/pose/position/{c}" for c in "xyz"},
    **{f"q{c}": f"/robot/pose/orientation/{c}" for c in "wxyz"},
    **{f"f{c}": f"/sensor/wrench/force/{c}" for c in "xyz"},
    **{f"t{c}": f"/sensor/wrench/torque/{c}" for c in "xyz"},
    "t": "__time",
}


def as_ros(source, target):
    """Other names, blanks for commas, and the wrench of the probe on the patient."""
    with source.open() as file:
        rows = list(csv.DictReader(file))
    names = [NAMES[name] for name in rows[0]]
    lines = ["# exported", "\t".join(names)]
    for row in rows:
        cells = [
            str(-float(v)) if k[0] in "ft" and k != "t" else v for k, v in row.items()
        ]
        lines.append("\t".join(cells))
    target.write_text("\n".join(lines))
    return target


def words(recording, output, more=""):
    if recording.name == "press.csv":  # as ROS names them
        more += " --columns t=__time"
    return (
        f"fit --surface {example.path('surface.nc')} --probe {example.PROBE} "
        f"--trajectory {recording} --shape 16,36,16 --points 150 --inner 10 "
        f"--sampling trilinear --formulation eq10 --weights own -o {output} {more}"
    )


@pytest.mark.slow
def test_the_command_names_the_mistake_and_the_option_mends_it(run, tmp_path):
    written = as_ros(example.path("press_fit.csv"), tmp_path / "press.csv")
    wrong = run(words(written, tmp_path / "wrong.nc"))
    assert wrong.status == 0
    assert "forces of the opposite sign?" in wrong.err
    assert "read them with --flip-wrench" in wrong.err
    right = run(words(written, tmp_path / "right.nc", "--flip-wrench --json"))
    told = json.loads(right.out)["sanity"]
    assert "opposite" not in right.err
    # an option that is itself the mistake is to be taken away
    own_sign = words(example.path("press_fit.csv"), tmp_path / "o.nc", "--flip-wrench")
    told_twice = run(own_sign)
    assert "read them with none of those options" in told_twice.err
    assert told["mistake"] is None
    assert told["recordings"][0]["name"] == "press.csv"
    expected = run(
        words(example.path("press_fit.csv"), tmp_path / "own.nc", "--json")
    ).told["sanity"]["recordings"][0]
    for name in ("force_residual_N", "torque_residual_Nm"):
        assert told["recordings"][0][name] == pytest.approx(expected[name], rel=1e-6)


COMMANDS = {
    "fit": "-o {output}",
    "tune": "",
    "path": "--formulation eq10 --weight force_weight=0.01,0.1 -o {output}",
    "refine-poses": "-o {output}",
}


@pytest.mark.parametrize("command", COMMANDS)
def test_strict_refuses_a_likely_mistake(run, tmp_path, command):
    output = tmp_path / "out"
    press = example.path("press_fit.csv")
    answer = run(
        f"{command} --surface {example.path('surface.nc')} --probe {example.PROBE} "
        f"--trajectory {press} --shape 16,36,16 --points 300 --inner 10 --flip-wrench "
        f"--strict {COMMANDS[command].format(output=output)}"
    )
    assert answer.status == 2
    assert "error: forces of the opposite sign?" in answer.errors[-1]
    assert answer.out == ""
    assert not output.exists()


def test_strict_judges_before_a_picture_or_a_rendering(run, tmp_path):
    press, field = example.path("press_fit.csv"), tmp_path / "field.nc"
    fitted = words(press, field, "--strict")
    assert run(fitted).status == 0
    shared = f"--field {field} --points 300 --trajectory {press} --strict"
    picture, poses = tmp_path / "p.png", tmp_path / "r.csv"
    flipped = f"--probe {example.PROBE} --flip-wrench --picture {picture}"
    about = f"{shared} --probe {example.PROBE} --torque-about origin"
    for answer, expected in (
        (run(f"evaluate {shared} {flipped}"), "opposite sign"),
        (run(f"evaluate {about} --picture {picture}"), "is --torque-about right?"),
        (run(f"render {shared} --probe sphere:0.02 -o {poses}"), "another probe"),
    ):
        assert answer.status == 2
        assert expected in answer.errors[-1]
    assert not picture.exists()
    assert not poses.exists()


def test_no_contact_and_a_delay_beyond_the_recording(run, tmp_path):
    """Nothing was measured: no field, with and without --strict."""
    press = read_trajectory(example.path("press_fit.csv"))
    away, output = tmp_path / "away.csv", tmp_path / "f.nc"
    up = 0.05 * press.position / np.linalg.norm(press.position, axis=1)[:, None]
    replace(press, position=press.position + up).save(away)
    own = words(away, output)
    assert "in none of" in run(own).errors[-1]
    late = words(example.path("press_fit.csv"), output, "--wrench-delay 1e9")
    told = run(late)
    assert "--wrench-delay of 1e+09 s is longer than the recording" in told.errors[-1]
    assert told.status == 2
    assert not output.exists()


@pytest.mark.slow
def test_torques_about_the_origin_come_back_about_the_origin(run, tmp_path):
    """What `render` writes is compared by `evaluate` with the same point: no error."""
    fitted = words(example.path("press_fit.csv"), tmp_path / "f.nc")
    about = "--torque-about 0,0,0.05"
    fit = run(f"{fitted} {about}")
    assert fit.status == 0
    assert "torques about: 0,0,0.05" in fit.out
    shared = (
        f"--field {tmp_path / 'f.nc'} --probe {example.PROBE} --points 300 --trajectory"
    )
    rendered = tmp_path / "rendered.csv"
    poses = example.path("press_test.csv")
    assert run(f"render {shared} {poses} -o {rendered} {about}").status == 0
    same = run(f"evaluate {shared} {rendered} {about} --json")
    assert "torques about" not in same.err
    errors = json.loads(same.out)
    assert errors["force_magnitude_error_N"] < 1e-9
    assert errors["torque_magnitude_error_Nm"] < 1e-9
    other = run(f"evaluate {shared} {rendered} --json")
    assert "fitted to torques about (0.0, 0.0, 0.05)" in other.err
    assert json.loads(other.out)["torque_magnitude_error_Nm"] > 1e-3


@pytest.mark.slow
def test_a_boundary_that_cannot_be_fitted_names_the_mistake(run, tmp_path):
    written = as_ros(example.path("press_fit.csv"), tmp_path / "press.csv")
    output = tmp_path / "f.nc"
    answer = run(words(written, output).replace("--inner 10", "--inner fit"))
    assert answer.status == 2
    assert "push into the patient" in answer.err
    assert "read them with --flip-wrench" in answer.err
    assert not output.exists()


def test_poses_off_a_field_s_grid_are_a_likely_mistake():
    inside, none = np.array([True, False]), np.zeros(2, np.int64)
    with pytest.warns(MistakeWarning, match="1 of 2 poses lie outside the field's"):
        warn_of_poses(inside, none, none > 0)


def test_a_tracker_s_jump_is_a_likely_mistake(run, tmp_path):
    press, jumped = read_trajectory(example.path("press_fit.csv")), tmp_path / "j.csv"
    late = (np.arange(len(press)) >= 50)[:, None]
    replace(press, position=press.position + late * [0.05, 0.0, 0.0]).save(jumped)
    own = words(jumped, tmp_path / "f.nc", "--strict")
    answer = run(own)
    assert answer.status == 2
    assert "the poses jump by 50 mm" in answer.errors[-1]
