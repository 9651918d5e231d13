"""The solver through algebraic multigrid: its solves and answers by dense algebra."""

import numpy as np
import pytest

from tests.kit import small_scene
from ttus_opt.problem.formulation import load
from ttus_opt.solvers.base import Claim, Request
from ttus_opt.solvers.packages.amg_pcg import AmgPcg, _Loaded

pytest.importorskip("pyamg", reason="needs ttus-opt[reference]")

SCENE = small_scene("trilinear", shape=(5, 8, 6), n_poses=4)


def loaded(weight=3.0):
    weights = {"force_weight": weight, "torque_weight": 0.2 * weight}
    program = load("eq10", SCENE, **weights).compile()
    prepared = AmgPcg().prepare(program, Request(1e-10))
    assert isinstance(prepared, _Loaded)
    return prepared


def test_its_solves_are_with_l_and_its_transpose():
    own, L = loaded(), SCENE.L.toarray()
    own._attempt(1e-10, None)  # sets how far solves go
    g = np.random.default_rng(0).normal(size=SCENE.n_voxels)
    np.testing.assert_allclose(own._solve(g), np.linalg.solve(L, g), atol=1e-8)
    adjoint = np.linalg.solve(L.T, g)
    np.testing.assert_allclose(own._solve_adjoint(g), adjoint, atol=1e-8)


@pytest.mark.parametrize("weight", [1e-3, 3.0, 1e3])
def test_its_answer_is_the_minimiser(weight):
    own = loaded(weight)
    found = own.solve()
    L, D = SCENE.L.toarray(), own._D.toarray()
    H, d = L.T @ L + D.T @ D, L.T @ SCENE.b + D.T @ own._t
    assert found.claim is Claim.DONE and found.x is not None
    expected = np.linalg.solve(H, d)
    np.testing.assert_allclose(found.x, expected, atol=1e-6 * np.abs(expected).max())


def test_out_of_time_there_is_no_answer():
    found = loaded()._attempt(1e-10, 0.0)
    assert found.claim is Claim.TIME_LIMIT and found.x is None
