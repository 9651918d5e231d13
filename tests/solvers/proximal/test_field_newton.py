"""Newton steps over all variables, by all ways, against dense algebra."""

import numpy as np
import pytest
import scipy.sparse as sp

from tests.solvers.proximal.dense_steps import (
    RTOL,
    SCENE,
    compared,
    expected,
    gradient_of,
    none_of,
    problem_of,
    slopes_of,
)
from ttus_opt.problem import formulation
from ttus_opt.problem.terms.penalties import Slope
from ttus_opt.solvers.proximal import field_newton
from ttus_opt.solvers.proximal.field_newton import FieldNewton, add_normal_product
from ttus_opt.solvers.proximal.problem import PenalisedProblem


@pytest.mark.parametrize("how", ["diagonal", "multigrid"])
@pytest.mark.parametrize("name", ["total_variation", "robust"])
def test_over_the_field(name, how, monkeypatch):
    problem = problem_of(name)
    slopes = slopes_of(problem, 1, 0.05)
    monkeypatch.setattr(field_newton, "FEW_ROWS", 50)  # what lies over all voxels here
    monkeypatch.setattr(field_newton, "MOST_STEPS", 2000)
    system = FieldNewton(problem)
    system._by_operator = how == "multigrid"
    gradient = gradient_of(problem)
    step, _ = system.step(gradient, none_of(problem), slopes, RTOL, None)
    compared(step, expected(problem, slopes, gradient))


def test_many_steps_ask_for_another_preconditioner(monkeypatch):
    monkeypatch.setattr(field_newton, "FEW_ROWS", 50)
    monkeypatch.setattr(field_newton, "MANY", 12)
    problem = problem_of("total_variation")
    slopes = slopes_of(problem, 2, 0.05)
    system, gradient = FieldNewton(problem), gradient_of(problem)
    _, by_diagonal = system.step(gradient, none_of(problem), slopes, 1e-6, None)
    assert by_diagonal > field_newton.MANY
    _, by_multigrid = system.step(gradient, none_of(problem), slopes, 1e-6, None)
    assert by_multigrid < by_diagonal


@pytest.mark.slow
@pytest.mark.parametrize("name", ["eq10", "volume_weighted"])
def test_with_few_rows_the_multigrid_is_the_inverse(name, monkeypatch):
    """Laplace's rows of any weight and scale beside heavy ones: all eigenvalues 1."""
    monkeypatch.setattr(field_newton, "FEW_ROWS", 50)
    prior = {"eq10": "laplace", "volume_weighted": "volume_weighted"}[name]
    given = formulation.load(name, SCENE, force_weight=30.0, torque_weight=10.0)
    program = given.with_weights(**{prior: 0.2}).compile()
    problem = PenalisedProblem.of(program.declared or program)
    slopes = [Slope(np.full(len(b.target), 2.0 * b.weight)) for b in problem.blocks]
    system = FieldNewton(problem)
    system._by_operator = True
    units = np.eye(len(problem.fixed))[~problem.fixed]
    inverse = [-expected(problem, slopes, unit) for unit in units]
    apply = system.preconditioner(slopes)
    H = np.linalg.inv(np.array(inverse)[:, ~problem.fixed])
    P = np.array([apply(unit) for unit in units])[:, ~problem.fixed]
    np.testing.assert_allclose(np.linalg.eigvals(P @ H), 1.0, atol=0.03)


@pytest.mark.parametrize("how", ["factor", "diagonal"])
def test_groups_are_no_longer_stiff_along_their_length(how, monkeypatch):
    if how == "diagonal":
        monkeypatch.setattr(field_newton, "MOST_STEPS", 2000)
    problem = problem_of("total_variation")
    slopes = slopes_of(problem, 4, 0.0)
    at = next(k for k, b in enumerate(problem.blocks) if not b.exact)
    factor = np.repeat(slopes[at].factor[::3], 3)
    along = np.random.default_rng(5).normal(size=(len(factor) // 3, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    slopes[at] = Slope(factor, along.reshape(-1), 3)
    gradient = gradient_of(problem)
    step, _ = FieldNewton(problem).step(gradient, none_of(problem), slopes, RTOL, None)
    compared(step, expected(problem, slopes, gradient))


@pytest.mark.parametrize("kind", [np.int32, np.int64])
def test_a_normal_product_is_added_and_rows_without_slope_are_left_out(kind):
    rng = np.random.default_rng(0)
    M = sp.random_array((30, 12), density=0.2, rng=rng, format="csr")
    M.indices, M.indptr = M.indices.astype(kind), M.indptr.astype(kind)
    slope = rng.uniform(size=30) * (rng.uniform(size=30) < 0.5)
    M.data[M.indptr[0] : M.indptr[1]] = np.nan  # never looked at
    slope[0] = 0.0
    v, before = rng.normal(size=12), rng.normal(size=12)
    out = before.copy()
    add_normal_product(out, M, slope, v)
    dense = M.toarray()[1:]
    expected = before + dense.T @ (slope[1:] * (dense @ v))
    np.testing.assert_allclose(out, expected, rtol=1e-13, atol=1e-13)
