"""Runs in their own processes: answers, crashes, limits, and going on after a stop."""

from __future__ import annotations

import json
import textwrap
from dataclasses import replace
from pathlib import Path

import pytest

from ttus_opt.benchmark import isolation, suite
from ttus_opt.benchmark.cases import SMALL_SHAPE, CaseSpec, reference_cases
from ttus_opt.benchmark.row import Row, RunSpec
from ttus_opt.benchmark.suite import Suite
from ttus_opt.errors import InputError

TINY = replace(
    reference_cases("S")[0], name="tiny", shape=(9, 20, 9), n_poses=10, n_points=300
)

#: A case whose small stand-in is smaller, whatever that is
TRAPPED = replace(
    TINY, name="trapped", shape=tuple(n + 1 for n in SMALL_SHAPE), n_poses=10
)

#: A formulation that behaves on the small stand-in and does something else on the case
TRAP = """
from formulations import eq10

def build(scene):
    if scene.n_voxels == {size}:
        {deed}
    return eq10.build(scene)
"""


def trap(folder: Path, deed: str) -> str:
    assert TRAPPED.small().n_voxels != TRAPPED.n_voxels
    file = folder / "trap.py"
    indented = textwrap.indent(deed, " " * 8).strip()
    file.write_text(TRAP.format(size=TRAPPED.n_voxels, deed=indented))
    return str(file)


def small_suite(folder: Path, **other: object) -> Suite:
    made = Suite([TINY], ["eq10"], ["closed_form", "osqp"], folder, time_limit=30.0)
    return replace(made, **other)  # type: ignore[arg-type]


@pytest.mark.slow
def test_answers_agree_with_the_closed_form_and_are_not_run_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[Row] = []
    asked = small_suite(tmp_path, formulations=["eq10", "eq10_sign"], repeat=2)
    rows = asked.run(told.append)
    by = {(row.formulation, row.solver): row for row in rows}
    assert len(told) == len(rows) == 4
    assert by["eq10_sign", "closed_form"].status == "refused"
    for key in (("eq10", "closed_form"), ("eq10", "osqp"), ("eq10_sign", "osqp")):
        row = by[key]
        assert row.solved, row.detail
        assert row.worst_relative is not None
        assert row.worst_relative <= 1e-6
        assert row.seconds_first is not None
        assert row.seconds_first > 0.0
        assert row.seconds_again is not None
        assert len(row.seconds_each["first"]) == 2
        assert row.peak_memory_bytes is not None
        assert row.peak_memory_bytes > 2**26
        assert row.objective_gap is not None
        assert row.objective_gap < 1e-6
    assert by["eq10", "osqp"].difference_from_closed_form is not None
    assert by["eq10", "osqp"].difference_from_closed_form < 1e-5
    assert by["eq10_sign", "osqp"].difference_from_closed_form is None

    def never(*arguments: object) -> Row:
        raise AssertionError("a run that is there was run again")

    monkeypatch.setattr(suite, "run_isolated", never)
    # cut off in the middle of a line, as an interruption may leave it
    with asked.rows_file.open("a") as file:
        file.write('{"key": "tiny')
    again = asked.run()
    assert [r.as_dict() for r in again] == [r.as_dict() for r in rows]


@pytest.mark.slow
def test_crash_is_a_row(tmp_path: Path) -> None:
    asked = small_suite(
        tmp_path / "out",
        cases=[TRAPPED],
        formulations=[trap(tmp_path, "import os\nos.abort()")],
        solvers=["osqp"],
        closed_form="",
    )
    (row,) = asked.run()
    assert row.status == "crashed"
    assert "SIGABRT during program" in row.detail


@pytest.mark.slow
def test_exception_is_a_row_with_its_last_line(tmp_path: Path) -> None:
    asked = small_suite(
        tmp_path / "out",
        cases=[TRAPPED],
        formulations=[trap(tmp_path, "raise KeyError('my own mistake')")],
        solvers=["osqp"],
        closed_form="",
    )
    (row,) = asked.run()
    assert row.status == "crashed"
    assert "trap" in row.detail


@pytest.mark.slow
def test_memory_limit_is_a_row(tmp_path: Path) -> None:
    deed = "import time\nimport numpy\nkeep = numpy.ones(2**28)\ntime.sleep(60)"
    asked = small_suite(
        tmp_path / "out",
        cases=[TRAPPED],
        formulations=[trap(tmp_path, deed)],
        solvers=["osqp"],
        closed_form="",
        memory_limit=2**30,
    )
    (row,) = asked.run()
    assert row.status == "memory limit"
    assert row.peak_memory_bytes is not None
    assert row.peak_memory_bytes > 2**30


@pytest.mark.slow
def test_a_run_that_is_refused_at_last_tells_its_memory(tmp_path: Path) -> None:
    """Refused by its own process, which had a size by then."""
    deed = """from ttus_opt.errors import InputError
raise InputError("not on this grid")"""
    (row,) = small_suite(
        tmp_path / "out",
        cases=[TRAPPED],
        formulations=[trap(tmp_path, deed)],
        solvers=["osqp"],
        closed_form="",
    ).run()
    assert (row.status, row.detail) == ("refused", "not on this grid")
    assert row.peak_memory_bytes is not None
    assert row.peak_memory_bytes > 2**26


@pytest.mark.slow
def test_who_does_not_stop_is_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(isolation, "LATE_SECONDS", 0.5)
    deed = """import time
from ttus_opt.solvers import closed_form
closed_form._Factorised.solve = lambda self: time.sleep(60)"""
    asked = small_suite(
        tmp_path / "out",
        cases=[TRAPPED],
        formulations=[trap(tmp_path, deed)],
        solvers=["closed_form"],
        time_limit=1.0,
    )
    (row,) = asked.run()
    assert row.status == "time limit"
    assert row.detail == "ended during first"


def test_jobs_give_the_same_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def quick(spec: RunSpec, fields: Path, limit: int | None) -> Row:
        return Row.failed(spec, "time limit", "")

    monkeypatch.setattr(suite, "run_isolated", quick)
    alone = small_suite(tmp_path / "1").run()
    both = small_suite(tmp_path / "2", jobs=2).run()
    assert [r.key for r in alone] == [r.key for r in both]
    saved = (tmp_path / "2" / "rows.jsonl").read_text().splitlines()
    assert {json.loads(line)["key"] for line in saved} == {r.key for r in alone}


def test_weights_go_where_they_are_known(tmp_path: Path) -> None:
    plan = small_suite(tmp_path, formulations=["eq10", "laplace_only"]).plan()
    options = {spec.formulation: dict(spec.options) for spec in plan}
    assert options["eq10"] == {"force_weight": 1e-2, "torque_weight": 1e-2}
    assert options["laplace_only"] == {}
    assert [spec.solver for spec in plan[:2]] == ["closed_form", "osqp"]


def named_cases(folder: Path, case: str, **other: object) -> list[str]:
    """Solvers that would run on a reference case, in order."""
    asked = small_suite(folder, cases=reference_cases(case), **other)
    return [spec.solver for spec in asked.plan()]


def test_the_reference_is_what_fits_the_case(tmp_path: Path) -> None:
    some = {"solvers": ["osqp"]}
    assert named_cases(tmp_path, "S", **some) == ["closed_form", "osqp"]
    assert named_cases(tmp_path, "M", **some) == ["osqp"]
    assert named_cases(tmp_path, "L", **some) == ["osqp"]
    # of all that are installed neither
    everyone: dict[str, object] = {"solvers": []}
    assert named_cases(tmp_path, "S", **everyone)[0] == "closed_form"
    large = named_cases(tmp_path, "L", **everyone)
    assert "structured" in large
    assert not [name for name in large if name.startswith("closed_form")]
    # who asks for one has it
    asked = named_cases(tmp_path, "L", closed_form="closed_form", **some)
    assert asked == ["closed_form", "osqp"]
    assert named_cases(tmp_path, "L", solvers=["closed_form"]) == ["closed_form"]
    assert named_cases(tmp_path, "S", closed_form="", **some) == ["osqp"]


def test_weight_is_everyones(tmp_path: Path) -> None:
    asked = small_suite(tmp_path, formulations=["eq10", "laplace_only"], weight=3.0)
    options = {spec.formulation: dict(spec.options) for spec in asked.plan()}
    assert options["eq10"] == {"force_weight": 3.0, "torque_weight": 3.0}
    assert options["laplace_only"] == {}


@pytest.mark.slow
def test_contested_rows_say_how_many_limits_are_active(tmp_path: Path) -> None:
    case = replace(TINY, n_poses=24).contested("reversed")
    (row,) = small_suite(
        tmp_path,
        cases=[case],
        formulations=["eq10_sign"],
        solvers=["structured"],
        closed_form="",
        weight=100.0,
    ).run()
    assert row.solved
    assert row.case == "tiny-reversed"
    assert row.active_limits
    # the active set says by itself how large it is
    assert f"{row.active_limits} limits active" in row.detail


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"solvers": ["oqsp"]}, "unknown solver 'oqsp', did you mean osqp"),
        ({"formulations": ["eq11"]}, "unknown formulation 'eq11'"),
        ({"closed_form": "osqp"}, "reference must be a closed form"),
        ({"repeat": 0}, "repeat must be at least 1"),
        ({"time_limit": 0.0}, "time_limit must be positive"),
        ({"weight": 0.0}, "weight must be positive"),
        ({"options": {"weight": 1.0}}, "has no option 'weight'"),
    ],
)
def test_bad_input_is_told_before_anything_runs(
    tmp_path: Path, change: dict[str, object], told: str
) -> None:
    with pytest.raises(InputError, match=told):
        small_suite(tmp_path / "out", **change).run()
    assert not (tmp_path / "out").exists()


def test_dask_that_is_not_there(tmp_path: Path) -> None:
    try:
        import distributed  # noqa: F401
    except ImportError:
        pass
    else:
        pytest.skip("dask is installed")
    with pytest.raises(InputError, match=r"dask\[distributed\]"):
        small_suite(tmp_path, dask="127.0.0.1:8786").run()


def test_case_of_files_that_are_gone_is_refused(tmp_path: Path) -> None:
    gone = CaseSpec(
        "user", str(tmp_path / "no.nc"), TINY.probe, TINY.trajectories, (9, 9, 9)
    )
    with pytest.raises(OSError, match="surface file not found"):
        small_suite(tmp_path / "out", cases=[gone]).run()
