"""``ttus-opt benchmark`` as it is typed."""

import json
from pathlib import Path
from typing import get_args

import pytest

from ttus_opt import example
from ttus_opt.benchmark import suite
from ttus_opt.benchmark.parts.base import parts
from ttus_opt.cli import main
from ttus_opt.contact.rows import Sampling


def crashed(spec, *others):
    return [parts()[spec.part].row(spec, "crashed", "")]


def own_scene():
    return [
        "--surface",
        str(example.path("surface.nc")),
        "--probe",
        "ellipsoid:0.030,0.0125,0.018",
        "--trajectory",
        str(example.path("press_fit.csv")),
        "--shape",
        "8,18,8",
        "--inner",
        "17",
    ]


def typed(*words):
    with pytest.raises(SystemExit) as ended:
        main(["benchmark", *words])
    assert isinstance(ended.value.code, int)
    return ended.value.code


@pytest.mark.slow
def test_own_scene_as_json(tmp_path, capsys):
    words = [*own_scene(), "--solvers", "osqp", "-o", str(tmp_path), "--json"]
    assert typed(*words) == 0
    told = json.loads(capsys.readouterr().out)
    by = {row["solver"]: row for row in told["rows"]}
    assert set(by) == {"closed_form", "osqp"}
    for row in by.values():
        assert row["status"] == "solved"
        assert row["case"] == "user"
        assert row["formulation"] == "eq10"
        for key in (
            "seconds_assembly",
            "seconds_first",
            "seconds_again",
            "peak_memory_bytes",
            "objective",
        ):
            assert row[key] > 0.0, key
        assert row["kkt"]["dual_relative"] < 1e-6
    assert by["closed_form"]["difference_from_closed_form"] == 0.0
    assert by["osqp"]["difference_from_closed_form"] < 1e-5
    assert "Against the closed form" in Path(told["report"]).read_text("utf-8")


@pytest.mark.slow
def test_export_runs_nothing(tmp_path, capsys):
    words = [*own_scene(), "--export", str(tmp_path / "files"), "--json"]
    assert typed(*words, "-o", str(tmp_path / "results")) == 0
    files = json.loads(capsys.readouterr().out)["files"]
    assert [Path(file).name for file in files] == ["user_eq10.mat", "user_eq10.npz"]
    assert all(Path(file).stat().st_size > 1000 for file in files)
    assert not (tmp_path / "results").exists()


def test_other_parts_as_json(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(suite, "run_isolated", crashed)
    words = ["--parts", "ripple,rendering", "-o", str(tmp_path)]
    assert typed(*words, "--json") == 1  # nothing was measured
    told = json.loads(capsys.readouterr().out)
    assert told["rows"] == told["recursion"] == told["assembly"] == []
    assert len(told["rendering"]) == len(get_args(Sampling))
    assert len(told["ripple"]) == 3
    assert "## Ripple" in Path(told["report"]).read_text("utf-8")
    assert typed(*words) == 1
    lines = capsys.readouterr().out.splitlines()
    assert "Ripple of the force in a slide:" in lines
    assert lines[-1] == told["report"]


def test_an_interrupt_says_that_the_same_call_goes_on(tmp_path, capsys, monkeypatch):
    def stopped(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(suite, "run_isolated", stopped)
    assert typed("--parts", "ripple", "-o", str(tmp_path)) == 130
    told = capsys.readouterr().err
    assert f"{tmp_path / 'rows.jsonl'}: repeat the call to continue" in told


def test_perturbed_cases(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(suite, "run_isolated", crashed)
    words = ["--case", "S,M", "--perturb", "noise", "--parts", "profile", "--json"]
    assert typed(*words, "-o", str(tmp_path)) == 1
    found = json.loads(capsys.readouterr().out)["profile"]
    assert [row["case"] for row in found] == ["S-noise", "M-noise"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--case", "XXL"], "unknown case 'XXL'"),
        (["--solvers", "clarabell"], "did you mean clarabel"),
        (["--formulations", "eq_10"], "unknown formulation 'eq_10', did you mean"),
        (["--closed-form", "osqp"], "reference must be a closed form"),
        (["--time-limit", "-3"], "--time-limit must be positive"),
        (["--probe", "sphere:0.02"], "--surface, --probe and --trajectory together"),
        (["--shape", "8,8,8"], "own needs --surface, --probe and --trajectory"),
        (["--case", "S,XXL"], "unknown case 'XXL'"),
        (["--perturb", "loud"], "unknown perturbation 'loud': choose from noise"),
        (["--parts", "riple"], "unknown part 'riple': choose from solvers, assembly"),
        (["--parts", "ripple", "--export", "here"], "leave --parts out"),
        (["--sampling", "cubic"], "sampling must be one of voxel-mean"),
        (["--weight", "-1"], "weight must be positive"),
        (["--tolerance", "2"], "tolerance must lie between 1e-14"),
    ],
)
def test_bad_input_is_one_line_and_status_2(tmp_path, capsys, words, told):
    assert typed(*words, "-o", str(tmp_path / "out")) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("error: ")
    assert told in lines[0]
    assert not (tmp_path / "out").exists()
