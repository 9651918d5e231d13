"""Means, gaps, differences, tables, pictures and the exported problems."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp

from tests.conftest import small_scene
from ttus_opt.benchmark.cases import reference_cases
from ttus_opt.benchmark.export import export_program
from ttus_opt.benchmark.growth import growth_table, growths
from ttus_opt.benchmark.page import write_page
from ttus_opt.benchmark.row import Row, RunSpec
from ttus_opt.benchmark.suite import finished
from ttus_opt.benchmark.summary import (
    closed_form_table,
    memory_table,
    ratio,
    row_table,
    scores,
    shifted_geometric_mean,
)
from ttus_opt.constraints.sign import Sign
from ttus_opt.errors import InputError
from ttus_opt.problem import formulation as shelf
from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Request
from ttus_opt.solvers.registry import solvers

KKT = {"primal": 0.0, "primal_relative": 0.0, "dual_relative": 2e-8}


def row(solver: str, seconds: float, objective: float, **other: object) -> Row:
    spec = RunSpec(reference_cases("S")[0], "eq10", solver, time_limit=100.0)
    solved = Row.failed(spec, "solved", "")
    made = replace(
        solved,
        seconds_first=seconds,
        seconds_again=seconds / 10,
        objective=objective,
        kkt=KKT,
        solver_memory_bytes=2**20,
        peak_memory_bytes=2**28,
        memory_by_stage={"first": 2**28},
        field_file=f"{solver}.npy",
    )
    return replace(made, **other)  # type: ignore[arg-type]


def failed(solver: str, status: str = "time limit") -> Row:
    spec = RunSpec(reference_cases("S")[0], "eq10", solver, time_limit=100.0)
    return Row.failed(spec, status, "ended during first")


def test_shifted_geometric_mean_by_hand() -> None:
    assert shifted_geometric_mean([3.0, 8.0], shift=1.0) == pytest.approx(5.0)
    assert shifted_geometric_mean([7.0], shift=10.0) == pytest.approx(7.0)


def test_failures_count_as_the_time_limit_and_refusals_do_not() -> None:
    rows = [
        row("fast", 1.0, 5.0),
        failed("slow"),
        failed("unable", "refused"),
        failed("absent", "not installed"),
        replace(row("slow", 3.0, 5.0), case="M"),
    ]
    found = {score.solver: score for score in scores(rows)}
    assert set(found) == {"fast", "slow"}
    assert found["slow"].solved == 1
    assert found["slow"].run == 2
    assert found["slow"].mean_first == pytest.approx((101.0 * 4.0) ** 0.5 - 1.0)
    assert [score.solver for score in scores(rows)] == ["fast", "slow"]


def test_gap_and_difference(tmp_path: Path) -> None:
    np.save(tmp_path / "closed_form.npy", np.array([3.0, 4.0]))
    np.save(tmp_path / "other.npy", np.array([3.0, 4.5]))
    rows = [row("closed_form", 10.0, 8.0), row("other", 1.0, 10.0), failed("slow")]
    done = finished(rows, "closed_form", tmp_path)
    assert done[0].objective_gap == 0.0
    assert done[0].difference_from_closed_form == 0.0
    assert done[1].objective_gap == pytest.approx(0.25)
    assert done[1].difference_from_closed_form == pytest.approx(0.1)
    assert done[2].objective_gap is None
    assert done[2].difference_from_closed_form is None


def test_answers_that_failed_the_check_set_no_standard(tmp_path: Path) -> None:
    low = row("wrong", 1.0, 1.0, status="inaccurate")
    done = finished([row("right", 1.0, 2.0), low], "closed_form", tmp_path)
    assert done[0].objective_gap == 0.0
    assert done[1].objective_gap is None


def test_tables_say_ratios_and_reasons(tmp_path: Path) -> None:
    np.save(tmp_path / "closed_form.npy", np.ones(2))
    np.save(tmp_path / "other.npy", np.ones(2))
    rows = finished(
        [row("closed_form", 10.0, 8.0), row("other", 1.0, 8.0), failed("slow")],
        "closed_form",
        tmp_path,
    )
    against = closed_form_table(rows, "closed_form")
    assert "reference" in against
    assert "× 0.1" in against
    assert "slow" not in against
    assert "time limit: ended during first" in row_table(rows)
    assert "256" in memory_table(rows)
    assert closed_form_table(rows, "closed_form_pardiso") == ""
    assert ratio(1.0, None) == "–"


def test_table_tells_active_limits() -> None:
    lines = row_table([row("a", 1.0, 1.0, active_limits=37), failed("b")]).splitlines()
    assert lines[0].rstrip("| ").endswith("active limits")
    assert lines[2].rstrip("| ").endswith("37")
    assert lines[3].rstrip("| ").endswith("–")


def test_page_has_the_closed_form_first_and_pictures(tmp_path: Path) -> None:
    rows = finished(
        [
            row("closed_form", 10.0, 8.0),
            row("other", 1.0, 8.0),
            replace(row("other", 3.0, 8.0), case="M", voxels=300_000),
            failed("slow"),
        ],
        "closed_form",
        tmp_path,
    )
    page = write_page(
        tmp_path,
        rows,
        closed_form="closed_form",
        command="ttus-opt benchmark",
        machine={"cores": "2"},
        memory=True,
    )
    text = page.read_text("utf-8")
    headings = [line for line in text.splitlines() if line.startswith("## ")]
    assert headings[0] == "## Against the closed form Q p = d"
    assert headings[-1] == "## Machine"
    assert "| eq10        | other  | S to M (2) | time ∝ V^0.63 |" in text
    for picture in ("time.png", "memory.png", "residual.png"):
        assert picture in text
        assert (tmp_path / picture).stat().st_size > 5_000


def test_growth_is_the_slope_of_verified_answers() -> None:
    def sized(solver: str, case: str, voxels: int, seconds: float) -> Row:
        return replace(row(solver, seconds, 1.0), case=case, voxels=voxels)

    rows = [
        sized("cube", "L", 100_000, 8.0e3),
        sized("cube", "S", 1_000, 8.0e-3),
        sized("cube", "M", 10_000, 8.0),
        replace(sized("cube", "XL", 10**6, 1.0), status="inaccurate"),
        sized("flat", "S", 1_000, 2.0),
        replace(sized("flat", "M", 10_000, 2.0), seconds_again=None),
        sized("alone", "S", 1_000, 2.0),
    ]
    flat, cube = growths(rows)
    assert (flat.solver, flat.again) == ("flat", None)
    assert flat.first == pytest.approx(0.0, abs=1e-12)
    assert cube.cases == ("S", "M", "L")
    assert cube.first == pytest.approx(3.0)
    assert cube.again == pytest.approx(3.0)
    assert growth_table(rows[-1:]) == ""


def signed_program() -> Program:
    scene = small_scene("trilinear", shape=(5, 10, 6), n_poses=6, seed=2)
    declared = shelf.load("eq10", scene, force_weight=1.0, torque_weight=1.0)
    return declared.with_constraints(Sign(scene)).compile()


def test_exported_problem_is_the_same_problem(tmp_path: Path) -> None:
    program = signed_program()
    solver = next(
        solvers()[name] for name in ("clarabel", "osqp") if solvers()[name].installed
    )
    p = solver.prepare(program, Request(1e-9)).solve().x
    assert p is not None
    files = export_program(program, tmp_path, "tiny")
    told = scipy.io.loadmat(files.matlab, squeeze_me=True)
    residuals = [np.sqrt(t.weight) * t.residual(p) for t in program.terms]
    x = np.concatenate([p, *residuals])
    value = 0.5 * x @ (told["P"] @ x) + told["q"] @ x + told["r"]
    assert value == pytest.approx(program.objective(p), rel=1e-12)
    rows = told["A"] @ x
    assert (rows >= told["l"] - 1e-6).all()
    assert (rows <= told["u"] + 1e-6).all()
    assert int(told["n_original"]) == program.n_variables
    with np.load(files.numpy) as archive:
        shape = (int(archive["m"]), int(archive["n"]))
        parts = tuple(archive[f"A_{part}"] for part in ("data", "indices", "indptr"))
        A = sp.csc_array(parts, shape=shape)
    assert abs(A - sp.csc_array(told["A"])).max() == 0.0


def test_group_norms_are_not_exported(tmp_path: Path) -> None:
    from tests.solvers.problems import program, term
    from ttus_opt.terms.penalties.groups import Groups

    bent = program([term(np.eye(2), [0, 0], 1.0, Groups(2))])
    with pytest.raises(InputError, match="no QP"):
        export_program(bent, tmp_path, "bent")
    assert not list(tmp_path.iterdir())
