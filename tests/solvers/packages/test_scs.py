"""SCS kept alive: what an update keeps, continuations, and what has no answer."""

import numpy as np
import pytest

from tests.solvers.problems import M, capped, minimum, program, rows, term
from ttus_opt.problem.terms.penalties import Linear
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers.base import Claim, Request
from ttus_opt.solvers.packages import splitting
from ttus_opt.solvers.registry import asked_for

pytest.importorskip("scs")

SOLVER = asked_for("scs")
INF = np.inf


@pytest.mark.parametrize(
    ("changed", "keeps"),
    [
        ({"target": 2.0}, True),
        ({"target": 1.0, "cap": 0.2}, True),
        ({"target": 1.0, "weight": 9.0}, False),
        ({"target": 1.0, "times": 4.0}, False),
    ],
    ids=["measured values", "limits", "weights", "rows"],
)
def test_an_update_keeps_the_solver(changed, keeps):
    """Where its vectors change alone; it cannot take another matrix."""
    prepared = SOLVER.prepare(capped(1.0), Request(1e-8))
    np.testing.assert_allclose(prepared.solve().x, minimum(1.0), atol=1e-6)
    kept = prepared._solver
    prepared.update(capped(**changed))
    assert (prepared._solver is kept) == keeps
    again = prepared.solve()
    np.testing.assert_allclose(again.x, minimum(**changed), atol=1e-6)


def test_it_goes_on_from_its_iterate(monkeypatch):
    """In pieces of 25 iterations, checked between, it comes to the same."""
    monkeypatch.setattr(splitting, "ITERATIONS", 25)
    problem, request = capped(1.0), Request(1e-9)
    found = SOLVER.prepare(problem, request).solve()
    assert found.iterations > 25
    assert kkt_residuals(problem, found.x, found.duals).worst_relative <= 1e-9
    np.testing.assert_allclose(found.x, minimum(1.0), atol=1e-7)
    monkeypatch.setattr(splitting.ScsLoaded, "continuations", 0)
    cut = SOLVER.prepare(problem, request).solve()
    assert cut.iterations == 25 and cut.claim is Claim.PAUSED
    assert kkt_residuals(problem, cut.x, cut.duals).worst_relative > 1e-9


@pytest.mark.parametrize("kind", ["infeasible", "unbounded"])
def test_what_has_no_answer_has_none(kind):
    """Nor is it a start for the next problem."""
    fit = [term(M, np.zeros(12)), term(np.eye(4), np.ones(4), name="ridge")]
    contrary = program(fit, [rows("reach", np.ones((2, 4)), [4.0, -INF], [INF, 3.0])])
    falling = program(
        [
            term(np.eye(2)[:1], [0.0]),
            term(np.eye(2), [0, 0], 1.0, Linear(), name="slope"),
        ]
    )
    given = {
        "infeasible": (contrary, Claim.INFEASIBLE),
        "unbounded": (falling, Claim.UNBOUNDED),
    }
    problem, claim = given[kind]
    prepared = SOLVER.prepare(problem, Request(1e-8))
    found = prepared.solve()
    assert found.x is None and found.claim is claim
    prepared.update(capped(1.0))
    np.testing.assert_allclose(prepared.solve().x, minimum(1.0), atol=1e-6)
