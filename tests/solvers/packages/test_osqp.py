"""OSQP kept alive: what an update keeps, continuations, and data it refuses."""

import numpy as np
import pytest

from tests.solvers.problems import M, bounds, capped, minimum, program, rows, term
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers.base import Claim, Request
from ttus_opt.solvers.packages import splitting
from ttus_opt.solvers.registry import asked_for

pytest.importorskip("osqp")

SOLVER = asked_for("osqp")
INF = np.inf


@pytest.mark.parametrize(
    "changed",
    [
        {"target": 2.0},
        {"target": 1.0, "cap": 0.2},
        {"target": 1.0, "weight": 9.0},
        {"target": 1.0, "times": 4.0},
    ],
    ids=["measured values", "limits", "weights", "rows"],
)
def test_an_update_keeps_the_solver(changed):
    prepared = SOLVER.prepare(capped(1.0), Request(1e-8))
    np.testing.assert_allclose(prepared.solve().x, minimum(1.0), atol=1e-6)
    kept = prepared._solver
    prepared.update(capped(**changed))
    assert prepared._solver is kept
    again = prepared.solve()
    assert again.claim is Claim.DONE
    np.testing.assert_allclose(again.x, minimum(**changed), atol=1e-6)


def test_other_rows_take_a_new_solver():
    prepared = SOLVER.prepare(capped(1.0), Request(1e-8))
    kept = prepared._solver
    prepared.update(program([term(M, np.ones(12))]))
    assert prepared._solver is not kept
    expected = np.linalg.lstsq(M, np.ones(12))[0]
    np.testing.assert_allclose(prepared.solve().x, expected, atol=1e-6)


def test_it_goes_on_from_its_iterate(monkeypatch):
    """In pieces of 25 iterations, checked between, it comes to the same."""
    monkeypatch.setattr(splitting, "ITERATIONS", 25)
    problem, request = capped(1.0), Request(1e-9)
    found = SOLVER.prepare(problem, request).solve()
    assert found.iterations > 25
    assert kkt_residuals(problem, found.x, found.duals).worst_relative <= 1e-9
    np.testing.assert_allclose(found.x, minimum(1.0), atol=1e-7)
    monkeypatch.setattr(splitting.OsqpLoaded, "continuations", 0)
    cut = SOLVER.prepare(problem, request).solve()
    assert cut.iterations == 25 and cut.claim is Claim.PAUSED
    assert kkt_residuals(problem, cut.x, cut.duals).worst_relative > 1e-9


def test_what_has_no_answer_has_none():
    contrary = program(
        [term(np.eye(2), [0.0, 0.0])],
        [rows("reach", [[1, 1], [1, 1]], [4.0, -INF], [INF, 3.0])],
    )
    found = SOLVER.prepare(contrary, Request(1e-6)).solve()
    assert found.x is None and found.claim is Claim.INFEASIBLE


def test_data_that_it_refuses():
    """A lower limit above its upper one: no solver object, and no crash."""
    crossed = program(
        [term(np.eye(2), [0.0, 0.0])], (), [bounds("box", [2, 0], [1, 9])]
    )
    prepared = SOLVER.prepare(crossed, Request(1e-6))
    found = prepared.solve()
    assert found.x is None and found.claim is Claim.GAVE_UP
    assert found.detail == "OSQP refuses the data"
    prepared.update(capped(1.0))
    np.testing.assert_allclose(prepared.solve().x, minimum(1.0), atol=1e-4)
