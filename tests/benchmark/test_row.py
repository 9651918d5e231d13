"""Questions: they survive the way to another process, and tell themselves apart."""

import json
from dataclasses import asdict, replace

import pytest

from ttus_opt.benchmark.cases import reference_cases
from ttus_opt.benchmark.row import AUTO, CLOSED_FORM, RunSpec, Settings

SPEC = RunSpec(
    "solvers",
    reference_cases("S")[0],
    {"formulation": "eq10", "solver": "osqp", "options": {"force_weight": 1e-2}},
)


def test_a_question_survives_json():
    for spec in (SPEC, RunSpec("ripple", None, {"voxel": 0.001})):
        again = RunSpec.from_dict(json.loads(json.dumps(asdict(spec))))
        assert again == spec
        assert again.key == spec.key


def test_the_key_tells_questions_apart():
    for other in (
        replace(SPEC, part="rendering"),
        replace(SPEC, time_limit=1.0),
        replace(SPEC, options={**SPEC.options, "solver": "scs"}),
        replace(SPEC, case=replace(SPEC.scene_case, n_poses=3)),
    ):
        assert other.key != SPEC.key


def test_a_run_is_named_by_what_tells_it_apart():
    assert SPEC.title == "S eq10 osqp"
    assert RunSpec("recursion", SPEC.case, {"updates": 3}).title == "S recursion"
    assert RunSpec("ripple", None, {"voxel": 0.001}).title == "– 0.001"


@pytest.mark.parametrize(
    ("asked", "meant"), [(AUTO, CLOSED_FORM), ("", ""), ("structured", "structured")]
)
def test_the_reference(asked, meant):
    assert Settings(closed_form=asked).reference == meant


def test_by_default_it_is_the_closed_form_where_it_fits():
    assert Settings().closed_form == AUTO
