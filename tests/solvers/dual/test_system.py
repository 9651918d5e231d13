"""The Schur complement against dense algebra, hard and scaled rows included."""

from dataclasses import replace

import numpy as np
import pytest

from tests.kit import small_scene
from ttus_opt.problem import formulation
from ttus_opt.solvers.dual.data import DualData
from ttus_opt.solvers.dual.system import DualSystem

SCENE = small_scene("trilinear", shape=(5, 8, 5), n_poses=4)


def data(name, weight=2.0):
    weights = {"force_weight": weight, "torque_weight": weight}
    return DualData.of(formulation.load(name, SCENE, **weights).compile())


@pytest.mark.parametrize("name", ["eq10", "eq10_hard_boundary", "volume_weighted"])
def test_the_products_are_those_of_dense_matrices(name):
    system = data(name).system
    L, D = SCENE.L.toarray(), system.root_weights[:, None] * system.rows.toarray()
    y = np.random.default_rng(0).normal(size=len(D))
    field = np.linalg.solve(L, system.compliance * np.linalg.solve(L.T, D.T @ y))
    np.testing.assert_allclose(
        system.response(y), field, atol=1e-10 * np.abs(field).max()
    )
    np.testing.assert_allclose(system.measure(field), D @ field)
    S_y = y + D @ field
    np.testing.assert_allclose(system.apply(y), S_y, rtol=1e-9)


def test_the_same_rows_may_have_other_weights():
    system, heavier = data("eq10").system, data("eq10", 3.0).system
    moved = replace(heavier, laplace=system.laplace)
    assert system.same_rows(moved)
    assert not system.same_rows(data("eq10_hard_boundary").system)
    other = moved.rows.copy()
    other.data[0] *= 2.0
    assert not system.same_rows(
        DualSystem(system.laplace, system.compliance, other, system.root_weights)
    )
