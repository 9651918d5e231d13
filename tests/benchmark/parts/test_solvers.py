"""Solvers: which run on which case, and what all rows together tell."""

from dataclasses import replace

import numpy as np
import pytest

from tests.benchmark.rows import failed, row
from tests.benchmark.tiny import TINY, tiny_suite
from ttus_opt.benchmark.cases import reference_cases
from ttus_opt.benchmark.parts.base import parts
from ttus_opt.benchmark.row import Settings
from ttus_opt.solvers import registry

PART = parts()["solvers"]


def named(case, **settings):
    """Solvers that would run on a reference case, in order."""
    plan = PART.plan(reference_cases(case), Settings(**settings))
    return [spec.options["solver"] for spec in plan]


def options(**settings):
    """Options by formulation."""
    asked = Settings(
        formulations=["eq10", "laplace_only"], solvers=["osqp"], **settings
    )
    told = (spec.options for spec in PART.plan([TINY], asked))
    return {each["formulation"]: dict(each["options"]) for each in told}


@pytest.mark.slow
def test_the_reference_is_what_fits_the_case():
    some = {"solvers": ["osqp"]}
    assert named("S", **some) == ["closed_form", "osqp"]
    assert named("M", **some) == named("L", **some) == ["osqp"]
    # of all that are installed neither
    assert named("S")[0] == "closed_form"
    large = named("L")
    assert "structured" in large
    assert not [name for name in large if name.startswith("closed_form")]
    # who asks for one has it
    assert named("L", closed_form="closed_form", **some) == ["closed_form", "osqp"]
    assert named("L", solvers=["closed_form"]) == ["closed_form"]
    assert named("S", closed_form="", **some) == ["osqp"]


def test_weights_go_where_they_are_known():
    assert options()["eq10"] == {"force_weight": 1e-2, "torque_weight": 1e-2}
    assert options(weight=3.0) == {
        "eq10": {"force_weight": 3.0, "torque_weight": 3.0},
        "laplace_only": {},
    }


def test_who_cannot_take_a_problem_is_refused_without_a_process():
    asked = Settings(formulations=["eq10_sign"], solvers=["closed_form", "osqp"])
    plan = PART.plan([TINY], asked)
    refused = PART.refused(plan)
    assert [refused[spec.key]["status"] for spec in plan if spec.key in refused] == [
        "refused"
    ]
    told = refused[plan[0].key]
    assert told["solver"] == "closed_form"
    assert told["peak_memory_bytes"] is None


def test_gap_and_difference(tmp_path):
    (tmp_path / "fields").mkdir()
    np.save(tmp_path / "fields" / "closed_form.npy", np.array([3.0, 4.0]))
    np.save(tmp_path / "fields" / "other.npy", np.array([3.0, 4.5]))
    rows = [row("closed_form", 10.0, 8.0), row("other", 1.0, 10.0), failed("slow")]
    done = PART.finished(rows, Settings(), tmp_path)
    assert [each["objective_gap"] for each in done] == [0.0, pytest.approx(0.25), None]
    assert [each["difference_from_closed_form"] for each in done] == [
        0.0,
        pytest.approx(0.1),
        None,
    ]


def test_answers_that_failed_the_check_set_no_standard(tmp_path):
    low = row("wrong", 1.0, 1.0, status="inaccurate")
    done = PART.finished([row("right", 1.0, 2.0), low], Settings(), tmp_path)
    assert done[0]["objective_gap"] == 0.0
    assert done[1]["objective_gap"] is None


@pytest.mark.slow
def test_auto_says_who_answered_and_what_it_took(tmp_path):
    (found,) = tiny_suite(tmp_path, solvers=["auto"], closed_form="").run()["solvers"]
    assert (found["solver"], found["status"]) == ("auto", "solved")
    assert found["taken"] in registry.estimating()
    assert 0.0 < found["cpu_again"] < 60.0
    assert 0.0 < found["cpu_first"] < 60.0


@pytest.mark.slow
def test_perturbed_rows_say_how_many_limits_are_active(tmp_path):
    case = replace(TINY, n_poses=24).perturbed("reversed")
    (found,) = tiny_suite(
        tmp_path,
        [case],
        formulations=["eq10_sign"],
        solvers=["structured"],
        closed_form="",
        weight=100.0,
    ).run()["solvers"]
    assert found["status"] == "solved"
    assert found["case"] == "tiny-reversed"
    assert found["active_limits"]
    # the active set says by itself how large it is
    assert f"{found['active_limits']} active limits" in found["detail"]
