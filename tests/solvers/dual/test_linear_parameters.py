"""Unknowns beside the field, against a dense bounded least-squares solver."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import lsq_linear

from tests.conftest import small_scene
from tests.dragging import dragged_scene
from ttus_opt.fitting.batch import fit
from ttus_opt.problem import formulation
from ttus_opt.solvers.dual.data import DualData
from ttus_opt.solvers.dual.linear_parameters import LinearParameters
from ttus_opt.solvers.dual.options import Accuracy
from ttus_opt.solvers.dual.solver import DualSolver


@pytest.mark.slow
@pytest.mark.parametrize("weight", [1e-2, 1.0])
def test_equals_dense_bounded_least_squares(weight: float) -> None:
    """Four columns, one of them empty, and bounds of which two are active."""
    scene = small_scene("trilinear", (8, 12, 8), n_poses=8)
    program = formulation.load(
        "eq10", scene, force_weight=weight, torque_weight=weight
    ).compile()
    data = DualData.of(program)
    m, V = len(data.t), len(data.b)
    E = np.random.default_rng(4).normal(size=(m, 4))
    E[:, 2] = 0.0
    rows = sp.diags_array(data.system.root_weights) @ data.system.rows
    M = np.block([[program.laplace.L.toarray(), np.zeros((V, 4))], [rows.toarray(), E]])
    target = np.concatenate([data.b, data.t])
    loose = np.linalg.lstsq(M, target, rcond=None)[0][V:]
    # 0 ≤ c for a positive and a negative one, c ≤ half of what the last would be
    lower = np.where([True, True, True, False], 0.0, -np.inf)
    upper = np.array([np.inf, np.inf, np.inf, loose[3] - 0.5 * abs(loose[3])])
    solver = DualSolver(data.system, LinearParameters(E, lower, upper))
    answer = solver.solve(data.b, data.t, Accuracy(1e-11))
    free = np.full(V, np.inf)
    dense = lsq_linear(
        M,
        target,
        (np.concatenate([-free, lower]), np.concatenate([free, upper])),
        method="bvls",
    )
    cost = 0.5 * np.sum((M @ np.concatenate([answer.p, answer.c]) - target) ** 2)
    assert cost <= dense.cost * (1.0 + 1e-9)
    np.testing.assert_allclose(answer.c[[0, 1, 3]], dense.x[V:][[0, 1, 3]], atol=1e-6)
    np.testing.assert_allclose(answer.p, dense.x[:V], atol=1e-6)
    assert answer.c[3] == pytest.approx(upper[3], abs=1e-9)


def test_the_bound_of_a_coefficient_carries_a_multiplier() -> None:
    """Drag along the motion: c ≥ 0 holds it back, and the KKT residuals close."""
    scene = dragged_scene("contact", mu=0.0, viscous=-20.0)
    solution = fit(scene, "viscous_drag", solver="structured", force_weight=1e-2)
    assert solution.kkt.worst_relative < 1e-8
    assert solution.field.parameters["viscous_coefficient"] == pytest.approx(0.0)
    assert solution.duals_by_name["viscous_sign"][0] < 0.0
