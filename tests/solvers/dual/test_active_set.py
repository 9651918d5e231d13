"""Where an iteration over working sets stands, after each of them."""

import time
from dataclasses import replace

import numpy as np

from tests.solvers.dual.test_field_pair import contested as contested_pair
from tests.solvers.dual.test_field_pair import coulomb
from tests.solvers.dual.user_limits import contested, eq10
from ttus_opt.laplace.system import RTOL
from ttus_opt.problem.constraints.signs import Sign
from ttus_opt.solvers.dual import options
from ttus_opt.solvers.dual.active_set import ActiveSetIteration
from ttus_opt.solvers.dual.data import DualData
from ttus_opt.solvers.dual.field_pair import FieldPair
from ttus_opt.solvers.dual.limits import SpokeLimits
from ttus_opt.solvers.dual.solver import Accuracy, DualSolver
from ttus_opt.solvers.dual.subproblem import LimitedField, Subproblem

SCENE = contested(0)
PROGRAM = eq10(SCENE, 1.0).with_constraints(Sign(SCENE)).compile()
LIMITS = SpokeLimits.of(PROGRAM)


def iteration(accuracy, tolerance=1e-6):
    data = DualData.of(PROGRAM)
    problem = LimitedField(PROGRAM, LIMITS, data, DualSolver(data.system))
    return ActiveSetIteration(problem, None, tolerance, accuracy)


def test_it_is_over_when_time_or_working_sets_are(monkeypatch):
    late = iteration(Accuracy(1e-8, deadline=time.perf_counter() - 1.0))
    late.solve(late.active, 1e-3)
    assert late.late and late.over and not late.settled
    monkeypatch.setattr(options, "MAX_WORKING_SETS", 1)
    once = iteration(Accuracy(1e-8))
    once.solve(once.active, 1e-3)
    assert once.over and not once.settled


def test_violations_that_may_remain_settle_it_after_some_working_sets():
    """Two are allowed; the third settles it, as any after it."""
    at = iteration(Accuracy(1e-8), tolerance=1e6)
    at.solve(at.active, 1e-3)  # solved less exactly than it is to be: not counted
    settled = []
    for _ in range(4):
        assert at.solve(at.active, 1e-8).count > 0
        settled.append(at.settled)
    assert settled == [False, False, True, True]


def test_a_model_is_asked_where_bounds_alone_are_violated(monkeypatch):
    monkeypatch.setattr(LimitedField, "predicted", lambda self, active, *_: active)
    at = iteration(Accuracy(1e-8))
    found = at.solve(at.active, 1e-8)
    assert at.predicted(found) is at.active
    links = np.where(np.arange(len(found.links)) == 3, 1e-3, -np.inf)
    assert at.predicted(replace(found, links=links)) is None
    at.active.links[3] = True
    assert at.predicted(found) is None


def test_violations_that_may_remain_count_by_the_smaller_field():
    """The KKT residuals of a second field are relative to its own size."""
    scene = contested_pair(1, noise=0.2, mu=0.0)
    pair = FieldPair.of(coulomb(scene, 1e-4, largest_friction=10.0).compile())
    at = ActiveSetIteration(pair, None, 1.0, Accuracy(1e-8))
    worst = at.solve(at.active, 1e-8).worst
    p, q = (np.abs(half).max() for half in np.split(at.p, 2))
    assert worst > 0.0 and q < 1e-2 * p
    settled = []
    # 10 would do, by a tenth of the tolerance times q's share: not a matter of rounding
    for times in (2.0, 50.0):
        tolerance = times * worst * p / q
        at = ActiveSetIteration(pair, None, tolerance, Accuracy(1e-8))
        for _ in range(3):
            at.solve(at.active, 1e-8)
        settled.append(at.settled)
    assert settled == [False, True]


def test_solves_are_as_exact_as_their_working_set_is_for(monkeypatch):
    """At the accuracy asked for to rounding, before it as far as that needs."""
    asked = []
    steps = []
    plain = Subproblem.solve

    def noted(self, accuracy, last):
        asked.append(accuracy)
        answer = plain(self, accuracy, last)
        steps.append(answer.steps)
        return answer

    monkeypatch.setattr(Subproblem, "solve", noted)
    at = iteration(Accuracy(1e-8))
    for rtol in (1e-3, 1e-8):
        at.solve(at.active, rtol)
    assert at.steps == sum(steps) > steps[0]
    assert [a.rtol for a in asked] == [1e-3, 1e-8]
    share = options.FIELD_ACCURACY
    assert [a.field_rtol for a in asked] == [share * 1e-3, RTOL]
    assert share * 1e-3 > RTOL
