"""OSQP and SCS kept alive: what an update keeps, continuations, no answer, bad data."""

import numpy as np
import pytest

from tests.solvers.problems import M, bounds, capped, minimum, program, rows, term
from ttus_opt.problem.terms.penalties import Linear
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers.base import Claim, Request
from ttus_opt.solvers.packages import splitting
from ttus_opt.solvers.registry import asked_for

INF = np.inf
LOADED = {"osqp": "OsqpLoaded", "scs": "ScsLoaded"}
#: Problems without an answer, and what is said of them
REACH = [rows("reach", np.ones((2, 4)), [4.0, -INF], [INF, 3.0])]
FIT = [term(M, np.zeros(12)), term(np.eye(4), np.ones(4), name="ridge")]
SLOPE = term(np.eye(2), [0, 0], 1.0, Linear(), name="slope")
WITHOUT = {
    ("osqp", Claim.INFEASIBLE): program(FIT, REACH),
    ("scs", Claim.INFEASIBLE): program(FIT, REACH),
    ("scs", Claim.UNBOUNDED): program([term(np.eye(2)[:1], [0.0]), SLOPE]),
}


def solver(name):
    pytest.importorskip(name)
    return asked_for(name)


@pytest.mark.parametrize("name", LOADED)
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
def test_an_update_keeps_the_solver(name, changed):
    """SCS where its vectors change alone; it cannot take another matrix."""
    prepared = solver(name).prepare(capped(1.0), Request(1e-8))
    np.testing.assert_allclose(prepared.solve().x, minimum(1.0), atol=1e-6)
    kept = prepared._solver
    prepared.update(capped(**changed))
    another = name == "scs" and not {"weight", "times"}.isdisjoint(changed)
    assert (prepared._solver is kept) != another
    again = prepared.solve()
    assert again.claim is Claim.DONE
    np.testing.assert_allclose(again.x, minimum(**changed), atol=1e-6)


@pytest.mark.parametrize("name", LOADED)
def test_it_goes_on_from_its_iterate(name, monkeypatch):
    """In pieces of 25 iterations, checked between, it comes to the same."""
    monkeypatch.setattr(splitting, "ITERATIONS", 25)
    problem, request = capped(1.0), Request(1e-9)
    found = solver(name).prepare(problem, request).solve()
    assert found.iterations > 25
    assert kkt_residuals(problem, found.x, found.duals).worst_relative <= 1e-9
    np.testing.assert_allclose(found.x, minimum(1.0), atol=1e-7)
    monkeypatch.setattr(getattr(splitting, LOADED[name]), "continuations", 0)
    cut = solver(name).prepare(problem, request).solve()
    assert cut.iterations == 25 and cut.claim is Claim.PAUSED
    assert kkt_residuals(problem, cut.x, cut.duals).worst_relative > 1e-9


@pytest.mark.parametrize(("name", "claim"), WITHOUT)
def test_what_has_no_answer_has_none(name, claim):
    """Nor is it a start for the next problem."""
    prepared = solver(name).prepare(WITHOUT[name, claim], Request(1e-8))
    found = prepared.solve()
    assert found.x is None and found.claim is claim
    prepared.update(capped(1.0))
    np.testing.assert_allclose(prepared.solve().x, minimum(1.0), atol=1e-6)


def test_data_that_it_refuses():
    """A lower limit above its upper one: no solver object, and no crash."""
    crossed = program(
        [term(np.eye(2), [0.0, 0.0])], (), [bounds("box", [2, 0], [1, 9])]
    )
    prepared = solver("osqp").prepare(crossed, Request(1e-6))
    found = prepared.solve()
    assert found.x is None and found.claim is Claim.GAVE_UP
    assert found.detail == "OSQP refuses the data"
    prepared.update(capped(1.0))
    np.testing.assert_allclose(prepared.solve().x, minimum(1.0), atol=1e-4)
