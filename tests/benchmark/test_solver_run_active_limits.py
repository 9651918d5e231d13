"""Counting active limits: by hand, and the same from solvers that share nothing."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.solvers import taking
from tests.solvers.problems import INF, bounds, program, rows, term
from ttus_opt.benchmark.cases import reference_cases
from ttus_opt.benchmark.solver_run import active_limits
from ttus_opt.problem.verify.kkt import Duals

#: A small case whose limits hold back or not
TINY = replace(
    reference_cases("S")[0], name="tiny", shape=(9, 20, 9), n_poses=24, n_points=300
)


def test_by_hand():
    # ‖x - (-1, 2, -3e-9, 5)‖² with x ≥ 0, x₂ ≤ 1 and x₄ = 4: two bounds hold back, a
    # third by nothing that counts; the equality is no limit
    target = np.array([-1.0, 2.0, -3e-9, 5.0])
    problem = program(
        [term(np.eye(4), target)],
        [rows("given", [[0, 0, 0, 1]], [4.0], [4.0])],
        [bounds("box", np.zeros(4), [INF, 1.0, INF, INF])],
    )
    x = np.array([0.0, 1.0, 0.0, 4.0])
    z = np.array([-2.0, 2.0, -6e-9, 0.0])
    assert active_limits(problem, x, Duals({"given": np.array([2.0])}, z)) == 2
    assert active_limits(problem, x, Duals({"given": np.array([2.0])})) == 0
    # an interior point's remains where nothing holds back: they are all alike
    remains = Duals({"given": np.array([2.0])}, np.full(4, -1e-8))
    assert active_limits(problem, x, remains) == 0


def test_inequality_rows_count():
    problem = program(
        [term(np.eye(2), [3.0, 3.0])],
        [rows("most", [[1, 0], [0, 1], [1, 1]], [-INF] * 3, [1.0, 2.0, 9.0])],
    )
    duals = Duals({"most": np.array([4.0, 2.0, 0.0])})
    assert active_limits(problem, np.array([1.0, 2.0]), duals) == 2


@pytest.mark.slow
@taking.over({"osqp", "scs", "clarabel"})
def test_solvers_agree(solver):
    name = solver.name
    counts = {}
    for how, weight in (("", 1e-2), ("reversed", 100.0)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scene = replace(TINY, perturbation=how).build()
        weights = {"force_weight": weight, "torque_weight": weight}
        for asked in ("structured", name):
            found = tt.fit(scene, "eq10_sign", solver=asked, **weights)
            x = found.candidate
            counts[how, asked] = active_limits(found.program, x, found.duals)
    assert counts["", "structured"] == counts["", name] == 0
    assert counts["reversed", "structured"] == counts["reversed", name] > 0
