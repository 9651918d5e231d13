"""Solvers against enumeration of all active sets and against dense linear algebra."""

import functools

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from tests.kit import small_scene, with_wrenches
from tests.oracles.dense import enumerated, minimiser, stacked
from tests.solvers import taking
from tests.solvers.problems import bounds, program, rows, term
from ttus_opt.problem.constraints.boundary import HardBoundary
from ttus_opt.problem.constraints.signs import Sign
from ttus_opt.problem.formulation import load
from ttus_opt.solvers.base import Request

#: Asked of every solver
TOLERANCE = 1e-9


@functools.cache
def random_case(seed):
    """Five variables with a box, two rows, and the answer by enumeration."""
    rng = np.random.default_rng(seed)
    n = 5
    M, t = rng.normal(size=(8, n)), rng.normal(size=8) * 3.0
    lower, upper = -rng.uniform(0.1, 1.0, n), rng.uniform(0.1, 1.0, n)
    R = rng.normal(size=(2, n))
    limit = rng.uniform(0.05, 0.4, 2)
    eye = np.eye(n)
    answer = enumerated(
        M, t, np.vstack([eye, -eye, R]), np.concatenate([upper, -lower, limit])
    )
    case = program(
        [term(M, t)],
        [rows("cap", R, [-np.inf, -np.inf], limit)],
        [bounds("box", lower, upper)],
    )
    return case, answer


@pytest.mark.parametrize("seed", range(2))
@taking.over(taking.BOUNDED)
def test_enumeration_of_active_sets(solver, seed):
    case, answer = random_case(seed)
    candidate = solver.prepare(case, Request(TOLERANCE, 60.0)).solve()
    np.testing.assert_allclose(candidate.x, answer, atol=1e-5)


@functools.cache
def tiny():
    """Eq. 10 on a grid small enough for dense algebra, with forces that pull."""
    scene = small_scene("trilinear", shape=(5, 8, 6), n_poses=6, seed=2)
    scene = with_wrenches(scene, -4.0 * scene.f)
    return load("eq10", scene, force_weight=1.0, torque_weight=1.0)


@functools.cache
def least_squares():
    """Eq. 10 and its answer by dense algebra."""
    problem = tiny().compile()
    return problem, minimiser(problem)


@taking.over(taking.FORMULATIONS["eq10"])
def test_eq10_is_dense_least_squares(solver):
    problem, answer = least_squares()
    candidate = solver.prepare(problem, Request(TOLERANCE, 60.0)).solve()
    assert np.linalg.norm(candidate.x - answer) <= 1e-6 * np.linalg.norm(answer)


@functools.cache
def bounded():
    """Eq. 10 with signs, and its answer by a dense active set."""
    problem = tiny().with_constraints(Sign(tiny().scene)).compile()
    M, t = stacked(problem)
    return problem, lsq_linear(M.toarray(), t, problem.box, method="bvls", tol=1e-14).x


@taking.over(taking.FORMULATIONS["eq10_sign"])
def test_sign_is_dense_bounded_least_squares(solver):
    problem, answer = bounded()
    held = np.isclose(answer, 0.0, atol=1e-12) & np.isfinite(problem.box).any(axis=0)
    assert held.any(), "no bound holds: the test would show nothing"
    candidate = solver.prepare(problem, Request(TOLERANCE, 60.0)).solve()
    assert np.linalg.norm(candidate.x - answer) <= 1e-4 * np.linalg.norm(answer)


@taking.over(taking.FORMULATIONS["eq10_hard_boundary"])
def test_hard_boundary_is_dense_elimination(solver):
    problem = tiny().with_constraints(HardBoundary(tiny().scene)).compile()
    (M, t), answer = stacked(problem), minimiser(problem)
    fixed = ~tiny().scene.laplace.free
    candidate = solver.prepare(problem, Request(TOLERANCE, 60.0)).solve()
    assert np.linalg.norm(candidate.x - answer) <= 1e-6 * np.linalg.norm(answer)
    # the multiplier is minus the gradient of the objective on the fixed voxels
    pull = 2.0 * M.T @ (M @ answer - t)
    got = candidate.duals.rows["boundary"]
    assert np.linalg.norm(got + pull[fixed]) <= 1e-5 * np.linalg.norm(pull)
