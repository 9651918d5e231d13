"""Bounds of the gap beside auxiliary variables, against optima of other solvers."""

import functools
from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest

import ttus_opt as tt
from tests.fitting.test_batch import TIMES
from tests.problem.terms.test_cvxpy_term import IDEAS, SCENE, eq10
from tests.solvers.problems import bounds, program, rows, term
from ttus_opt.fitting.verdict import judged
from ttus_opt.problem.formulation import load
from ttus_opt.problem.reduction import reduce
from ttus_opt.problem.verify.kkt import Duals, kkt_residuals
from ttus_opt.problem.verify.loose_columns import exact_rows, loose_variables
from ttus_opt.solvers.base import Claim, Request

INF = np.inf


@functools.cache
def answered():
    """A formulation with an idea, its program, and Clarabel's answer."""
    plain = load("eq10", SCENE, force_weight=0.1, torque_weight=0.0)
    model = plain + tt.CvxpyTerm("x", lambda p: cp.max(p[2]), weight=1e-6)
    answer = tt.Fitter(model, solver="clarabel")._prepared.solve()
    return model, model.compile(), answer


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-4, 1e-6])
def test_a_field_that_ignores_all_data_is_not_solved(tolerance):
    """Multipliers that miss by 1e-9 are no licence for it."""
    model, whole, answer = answered()
    best = whole.objective(answer.x)
    p = SCENE.laplace.solve(SCENE.b)
    x = np.concatenate([p, [p.reshape(SCENE.voxmap.grid.shape)[2].max()]])
    assert whole.objective(x) > 1.1 * best
    for factor in (1.0 - 1e-9, 1.0, 1.0 + 1e-9):
        near = {name: factor * y for name, y in answer.duals.rows.items()}
        kkt = kkt_residuals(whole, x, Duals(near), tolerance=tolerance)
        assert kkt.is_bound
        assert kkt.gap >= (whole.objective(x) - best) * (1.0 - 1e-6)
        wrong = replace(answer, x=x, duals=Duals(near), claim=Claim.DONE)
        at = model, reduce(whole), "by hand", wrong, Request(tolerance), TIMES
        assert judged(*at).status is not tt.Status.SOLVED
        right = replace(answer, duals=Duals(near))
        assert kkt_residuals(whole, answer.x, Duals(near)).gap_relative < 1e-5
        at = model, reduce(whole), "by hand", right, Request(1e-4), TIMES
        assert judged(*at).status is tt.Status.SOLVED


MORE = {
    **{name: idea for name, (idea, _) in IDEAS.items()},
    "huber": lambda p: cp.sum(cp.huber(cp.diff(p, axis=2), 0.1)),
    "a norm": lambda p: cp.norm(cp.vec(p[1:3], order="C")),
    "largest of sizes": lambda p: cp.norm_inf(cp.vec(p[1:3], order="C")),
    "a hinge": lambda p: cp.sum(cp.pos(1.0 - p[:, :, 3])),
}


@pytest.mark.parametrize("idea", MORE)
def test_every_idea_has_a_bound(idea):
    """Of its answer a small one, of other points one above the excess."""
    solution = tt.fit(SCENE, eq10() + tt.CvxpyTerm("edge", MORE[idea], 0.05))
    assert solution.status is tt.Status.SOLVED
    assert solution.kkt is not None and solution.kkt.is_bound
    whole, x, duals = solution.program, solution.candidate, solution.duals
    best, rng = whole.objective(x), np.random.default_rng(0)
    for size in (1e-3, 1e-1):
        near = {
            name: y * (1.0 + size * rng.normal(size=len(y)))
            for name, y in duals.rows.items()
        }
        kkt = kkt_residuals(whole, x, replace(duals, rows=near))
        assert kkt.is_bound
        assert kkt.gap >= -1e-6 * best


def hinge(cost=1.0):
    """x² + cost·t with t ≥ x − 1 and t ≥ 0, both as rows."""
    return program(
        [
            term([[1.0, 0.0]], [2.0]),
            term([[0.0, cost]], [0.0], 1.0, tt.terms.Linear(), name="cost"),
        ],
        [rows("above", [[-1.0, 1.0], [0.0, 1.0]], [-1.0, 0.0], [INF, INF])],
    )


def test_multipliers_become_exact_nearby():
    one = hinge()
    loose = loose_variables(one, np.zeros(2, dtype=bool))
    np.testing.assert_array_equal(loose, [False, True])
    found = exact_rows(one, {"above": np.array([-0.7, -0.299])}, loose)
    np.testing.assert_allclose(found["above"].sum(), -1.0, rtol=1e-15)
    np.testing.assert_allclose(found["above"], [-0.7, -0.3], atol=1e-3)
    assert exact_rows(hinge(0.0), {"above": np.zeros(2)}, loose) is not None
    # a cost that no row can hold against: unbounded below
    assert exact_rows(hinge(-1.0), {"above": np.array([-0.7, -0.3])}, loose) is None


def test_the_bound_counts_slack_of_rows():
    """At x = 0, t = 3 the row t ≥ 0 is 3 away: all of the excess is there."""
    one = hinge()
    x = np.array([2.0, 3.0])
    kkt = kkt_residuals(one, x, Duals({"above": np.array([-0.4, -0.6])}))
    assert kkt.is_bound
    # least: x = 1.5, t = 0.5 with 0.25 + 0.5
    assert kkt.gap >= (0.0 + 3.0) - 0.75


def test_variables_with_limits_or_squares_are_not_loose():
    held = program(hinge().terms, (), [bounds("half", [-INF, 0.0], [INF, INF])])
    assert not loose_variables(held, np.zeros(2, dtype=bool)).any()
    assert not loose_variables(hinge(), np.ones(2, dtype=bool)).any()
    free = program([term([[1.0, 0.0]], [0.0])])
    assert loose_variables(free, np.zeros(2, dtype=bool))[1]
