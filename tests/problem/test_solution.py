import json
from dataclasses import replace

import numpy as np
import pytest

from tests.kit import small_scene
from ttus_opt.fitting.batch import fit, judged
from ttus_opt.problem.formulation import load
from ttus_opt.problem.reduction import reduce
from ttus_opt.problem.solution import NoSolutionError, Status, Timings
from ttus_opt.solvers.base import Candidate, Request

SCENE = small_scene(shape=(5, 8, 5), n_poses=4)


def test_every_status_is_advice():
    for status in Status:
        assert len(status.value.split()) > 5


def test_times_that_were_not_taken_are_left_out():
    first = Timings(1.0, 2.0, 3.0)
    told = {"assembly": 1.0, "setup": 2.0, "solve": 3.0, "compile": 0.0}
    assert first.as_dict() == told
    assert Timings(1.0, 2.0, 3.0, again=0.5).as_dict()["again"] == 0.5
    assert Timings(1.0, 2.0, 3.0, search=9.0).as_dict()["search"] == 9.0


def test_no_solution_carries_program_and_candidate():
    declared = load("eq10_sign", SCENE)
    reduction = reduce(declared.compile())
    candidate = Candidate(np.ones(SCENE.n_voxels))
    solution = judged(
        declared, reduction, "by hand", candidate, Request(), Timings(0.0, 0.0, 0.0)
    )
    assert solution.status is Status.INACCURATE
    with pytest.raises(NoSolutionError) as caught:
        _ = solution.field
    message = str(caught.value)
    assert "\n" not in message
    assert "eq10_sign: inaccurate, KKT" in message
    assert caught.value.solution.program.variables["p"].stop == SCENE.n_voxels
    assert caught.value.solution.candidate is not None
    assert set(solution.variables) == {"p"}


def test_what_was_found_goes_into_json():
    declared = load("eq10", SCENE)
    solved = json.loads(json.dumps(fit(SCENE, declared).as_dict()))
    assert solved["status"] == "solved" and solved["advice"] == ""
    assert solved["voxels"] == SCENE.n_voxels and solved["attempts"] == []
    assert sum(solved["costs"].values()) == pytest.approx(solved["objective"])
    assert solved["kkt"]["gap"] <= 1e-6
    arguments = "by hand", Candidate(None), Request(), Timings(0.0, 0.0, 0.0)
    nothing = judged(declared, reduce(declared.compile()), *arguments).as_dict()
    assert nothing["advice"] == Status.FAILED.value and nothing["kkt"] is None


def test_a_solution_shows_itself_in_one_line_and_in_a_table():
    """Verdict, costs, what is active and what was found; text is escaped in HTML."""
    scene = small_scene("trilinear", shape=(8, 12, 8), n_poses=10)
    weights = {"force_weight": 10.0, "torque_weight": 10.0}
    declared = load("eq10_sign", scene, **weights).named("<mine>")
    solution = fit(scene, declared)
    assert "\n" not in repr(solution)
    assert repr(solution).startswith("<Solution <mine> by structured: solved, KKT ")
    told = solution.summary()
    active = int((np.abs(solution.duals_by_name["sign"]) > 0.0).sum())
    assert active > 3
    assert f"sign: {active} of " in told
    for name, cost in solution.costs.items():
        assert f"{name}: cost {cost:.4g}" in told
    sign = np.r_[1e-3, 1e3, 0.0, np.zeros(len(solution.duals_by_name["sign"]) - 3)]
    few = replace(solution, duals=replace(solution.duals, bounds=[sign]))
    assert "sign: 1 of " in few.summary()
    page = solution._repr_html_()
    assert "&lt;mine&gt;" in page
    assert "<mine>" not in page
    assert "<td>sign</td>" in page
    assert len(repr(solution.program)) < 200
    table = declared._repr_html_()
    assert "&lt;mine&gt;" in table
    assert "‖L p − b‖²" in table
