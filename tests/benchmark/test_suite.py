"""The whole benchmark: planned, refused, run once, and going on after a stop."""

import json
from dataclasses import replace
from typing import get_args

import pytest

from tests.benchmark.tiny import TINY, tiny_suite
from tests.kit import InputError, MissingPackageError, TtusWarning, refuses
from ttus_opt.benchmark import suite
from ttus_opt.benchmark.parts.base import parts
from ttus_opt.contact.rows import Sampling


def never(*arguments):
    raise AssertionError("a run that is there was run again")


def ended(spec, *others):
    return [parts()[spec.part].row(spec, "time limit", "")]


def interrupt(file):
    """Cut off in the middle of a line, as an interruption may leave it."""
    with file.open("a") as lines:
        lines.write('[{"key": "tiny')


@pytest.mark.slow
def test_answers_agree_with_the_closed_form_and_are_not_run_twice(
    tmp_path, monkeypatch
):
    told = []
    asked = tiny_suite(tmp_path, formulations=["eq10", "eq10_sign"], repeat=2)
    rows = asked.run(lambda spec, rows: told.extend(rows))["solvers"]
    by = {(row["formulation"], row["solver"]): row for row in rows}
    assert len(told) == len(rows) == 4
    assert by["eq10_sign", "closed_form"]["status"] == "refused"
    for key in (("eq10", "closed_form"), ("eq10", "osqp"), ("eq10_sign", "osqp")):
        row = by[key]
        assert row["status"] == "solved", row["detail"]
        assert row["kkt"]["dual_relative"] <= 1e-6
        assert row["seconds_first"] > 0.0
        assert row["seconds_again"] > 0.0
        assert len(row["seconds_each"]["first"]) == 2
        assert row["peak_memory_bytes"] > 2**26
        assert row["objective_gap"] < 1e-6
        assert (tmp_path / "fields" / row["field_file"]).exists()
    assert by["eq10", "osqp"]["difference_from_closed_form"] < 1e-5
    assert by["eq10_sign", "osqp"]["difference_from_closed_form"] is None
    monkeypatch.setattr(suite, "run_isolated", never)
    interrupt(asked.rows_file)
    again = tiny_suite(tmp_path, formulations=["eq10", "eq10_sign"], repeat=2)
    with pytest.warns(TtusWarning, match="4 of 4 runs are those of an earlier call"):
        assert again.run()["solvers"] == rows


def test_a_package_that_was_missing_is_looked_for_again(tmp_path, monkeypatch):
    def missing(spec, *others):
        return [parts()[spec.part].row(spec, "not installed", "pip install it")]

    for run, status in ((missing, "not installed"), (ended, "time limit")):
        monkeypatch.setattr(suite, "run_isolated", run)
        rows = tiny_suite(tmp_path, parts=["ripple"]).run()["ripple"]
        assert {row["status"] for row in rows} == {status}


def test_an_interrupted_benchmark_goes_on(tmp_path, monkeypatch):
    names = ("ripple", "rendering")

    def stopped(spec, *others):
        if spec.part == "rendering":
            raise KeyboardInterrupt
        return ended(spec)

    monkeypatch.setattr(suite, "run_isolated", stopped)
    refuses(KeyboardInterrupt, "", tiny_suite(tmp_path, parts=names).run)
    run = []

    def counted(spec, *others):
        run.append(spec.part)
        return ended(spec)

    monkeypatch.setattr(suite, "run_isolated", counted)
    with pytest.warns(TtusWarning, match="3 of 6 runs are those of an earlier call"):
        rows = tiny_suite(tmp_path, parts=names).run()
    assert run == ["rendering"] * len(get_args(Sampling))
    assert len(rows["ripple"]) == 3


def test_jobs_give_the_same_rows(tmp_path, monkeypatch):
    monkeypatch.setattr(suite, "run_isolated", ended)
    names = ["solvers", "ripple"]
    alone = tiny_suite(tmp_path / "1", parts=names).run()
    both = tiny_suite(tmp_path / "2", parts=names, jobs=2).run()
    assert alone == both
    saved = (tmp_path / "2" / "rows.jsonl").read_text().splitlines()
    keys = {row["key"] for name in names for row in alone[name]}
    assert {json.loads(line)[0]["key"] for line in saved} == keys


def test_failures_say_which_run_they_are(tmp_path, monkeypatch):
    monkeypatch.setattr(suite, "run_isolated", ended)
    rows = tiny_suite(tmp_path, parts=["rendering"]).run()["rendering"]
    assert [row["sampling"] for row in rows] == list(get_args(Sampling))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"solvers": ["oqsp"]}, "unknown solver 'oqsp', did you mean osqp"),
        ({"formulations": ["eq11"]}, "unknown formulation 'eq11'"),
        ({"closed_form": "osqp"}, "reference must be a closed form"),
        ({"repeat": 0}, "repeat must be at least 1"),
        ({"jobs": 0}, "jobs must be at least 1"),
        ({"time_limit": 0.0}, "time_limit must be positive"),
        ({"weight": 0.0}, "weight must be positive"),
        ({"options": {"weight": 1.0}}, "has no option 'weight'"),
    ],
)
def test_bad_input_is_told_before_anything_runs(tmp_path, change, told):
    refuses(InputError, told, tiny_suite(tmp_path / "out", **change).run)
    assert not (tmp_path / "out").exists()


def test_case_of_files_that_are_gone_is_refused(tmp_path):
    gone = replace(TINY, surface=str(tmp_path / "no.nc"))
    refuses(OSError, "surface file not found", tiny_suite(tmp_path / "out", [gone]).run)


def test_dask_that_is_not_there(tmp_path):
    try:
        import distributed  # noqa: F401
    except ImportError:
        pass
    else:
        pytest.skip("dask is installed")
    with pytest.raises(MissingPackageError, match=r"ttus-opt\[parallel\]"):
        replace(tiny_suite(tmp_path), dask="127.0.0.1:8786").run()
