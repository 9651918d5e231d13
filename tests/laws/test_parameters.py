"""Law of parameters: each comes with a standard error, or with a reason."""

import functools

import pytest

import ttus_opt as tt
from tests.kit import dragged_scene
from ttus_opt.contact import friction
from ttus_opt.problem.formulation import available

#: What a field carries for rendering, given and not identified
GIVEN = {
    friction.DRAG_DEADBAND,
    friction.DRAG_AT_REFERENCE,
    friction.DRAG_AT_POINTS,
    friction.SECTORS,
    friction.BANDS,
    *friction.DRAG_AXIS,
}


@functools.cache
def fitted():
    made = dragged_scene("contact", shape=(8, 18, 9))
    return tt.Scene.assemble(
        made.voxmap, made.shell, made.trajectory, inner="fit", sampling="trilinear"
    )


@pytest.mark.parametrize("name", [info.name for info in available()])
def test_every_parameter_is_told_how_well(name):
    options = {} if name == "laplace_only" else {"force_weight": 1e-2}
    solution = tt.fit(fitted(), name, **options)
    assert solution.status is tt.Status.SOLVED, solution.advice
    identified = set(solution.parameters) - GIVEN
    errors, reasons = set(solution.standard_errors), set(solution.not_identified)
    assert identified == errors | reasons
    assert not errors & reasons
    assert all(error > 0.0 for error in solution.standard_errors.values())
    assert all(solution.not_identified.values())
    lines = {line.split()[0].rstrip(":") for line in solution.identified}
    assert lines == set(solution.parameters)
