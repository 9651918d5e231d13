"""Unknowns beside the field, against a dense bounded least-squares solver."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import lsq_linear

from tests.kit import dragged_scene, small_scene
from ttus_opt.fitting.batch import fit
from ttus_opt.problem import formulation
from ttus_opt.solvers.dual.data import DualData
from ttus_opt.solvers.dual.linear_parameters import Complement, LinearParameters
from ttus_opt.solvers.dual.solver import Accuracy, DualSolver


@pytest.mark.slow
@pytest.mark.parametrize("weight", [1e-2, 1.0])
def test_equals_dense_bounded_least_squares(weight):
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


def test_the_bound_of_a_coefficient_carries_a_multiplier():
    """Drag along the motion: c ≥ 0 holds it back, and the KKT residuals close."""
    scene = dragged_scene("contact", mu=0.0, viscous=-20.0)
    solution = fit(scene, "viscous_drag", solver="structured", force_weight=1e-2)
    assert solution.kkt.worst_relative < 1e-8
    assert solution.field.parameters["viscous_coefficient"] == pytest.approx(0.0)
    assert solution.duals_by_name["viscous_sign"][0] < 0.0


def test_what_violates_is_what_could_lessen_the_cost():
    """The cost falls along Eᵀy; columns and multipliers of any size."""
    y = np.array([3e4, -4e4, 1e-6, 1e-4])  # of norm 5e4
    E = np.zeros((4, 5))
    # a rise, a fall, one that is flat, one that hardly is not, and a column of nothing
    E[[0, 1, 2, 3], [0, 1, 2, 3]] = 20.0, 20.0, 2.0, 2.0
    beside = LinearParameters(E, np.full(5, -1.0), np.full(5, 1.0))
    rises, falls, hardly = 0, 1, 3
    assert beside.moving.tolist() == [True, True, True, True, False]
    held = np.zeros(5, dtype=bool)
    for value, expected in (
        (-1.0, {rises, hardly}),  # at the lower bound
        (0.0, {rises, falls, hardly}),
        (1.0, {falls}),  # at the upper one
    ):
        c = np.full(5, value)
        assert set(np.flatnonzero(beside.violating(c, y, held))) == expected
        assert not beside.violating(c, y, ~held).any()
        assert beside.between(c).tolist() == [value == 0.0] * 4 + [False]
    for value in (-1.5, 1.5):
        c = np.full(5, value)
        assert beside.violating(c, y, ~held).all()
        assert not beside.between(c).any()
        assert beside.clipped(c).tolist() == [np.sign(value)] * 5
    none = LinearParameters.none(4)
    assert none.columns.shape == (4, 0) and none.lower.shape == none.upper.shape == (0,)
    assert not LinearParameters.none(4).violating(np.zeros(0), y, held[:0]).any()


@pytest.mark.parametrize("columns", [0, 1, 3])
def test_across_columns_is_dense_algebra(columns):
    """With a column that is the sum of the others."""
    rng = np.random.default_rng(columns)
    root = rng.normal(size=(7, 7))
    S, r, E = root @ root.T + np.eye(7), rng.normal(size=7), rng.normal(size=(7, 3))
    E = np.column_stack([E[:, :columns], E[:, :columns].sum(axis=1)])
    across = Complement(E if columns else E[:, :0], lambda v: np.linalg.solve(S, v))
    nearest = np.linalg.lstsq(E, r)[0] if columns else np.zeros(0)
    np.testing.assert_allclose(across.coefficients(r), nearest, atol=1e-12)
    left = r - E[:, : len(nearest)] @ nearest
    np.testing.assert_allclose(across.part(r), left, atol=1e-12)
    # the y across E for which S y is r but along E
    y = across.precondition(r)
    if columns:
        np.testing.assert_allclose(E.T @ y, 0.0, atol=1e-12)
    np.testing.assert_allclose(across.part(S @ y), left, atol=1e-11)


@pytest.mark.parametrize("scale", [1e-20, 1e20])
def test_the_unit_of_columns_is_of_no_matter(scale):
    """Two columns and their sum: two directions, in whatever unit."""
    E = np.random.default_rng(6).normal(size=(9, 2))
    E = np.column_stack([E, E.sum(axis=1)])
    residual = np.random.default_rng(7).normal(size=9)
    one, other = (Complement(unit * E, lambda v: v) for unit in (1.0, scale))
    np.testing.assert_allclose(other.part(residual), one.part(residual), atol=1e-12)
    np.testing.assert_allclose(E.T @ other.part(residual), 0.0, atol=1e-12)
    expected = np.linalg.pinv(E) @ residual
    np.testing.assert_allclose(scale * other.coefficients(residual), expected)
