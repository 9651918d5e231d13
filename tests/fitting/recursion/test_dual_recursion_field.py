"""Conjugate gradients of the dual system against its dense solution."""

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.core.errors import NumericalError
from ttus_opt.fitting.recursion import dual_recursion
from ttus_opt.fitting.recursion.dual_recursion import FIELD_RTOL, DualRecursion
from ttus_opt.fitting.recursion.measured_rows import Block

HEIGHT, BLOCKS = 3, 4


@pytest.fixture(scope="module")
def coarse():
    return small_scene(shape=(7, 12, 7), n_poses=2)


def measured(scene, weight, monkeypatch):
    """Random local rows and their misfits, refined without a factor: R = 0."""
    rng, V = np.random.default_rng(12), scene.n_voxels
    system = DualRecursion(scene.laplace, scene.b, height=HEIGHT)
    dense, misfit = np.zeros((BLOCKS * HEIGHT, V)), rng.normal(size=BLOCKS * HEIGHT)
    for s in range(BLOCKS):
        voxels = np.sort(rng.choice(V, 9, replace=False))
        values = rng.normal(size=(9, HEIGHT)) * np.sqrt(weight)
        forecast = system.forecast(Block(voxels.astype(np.int32), values))
        rows = slice(HEIGHT * s, HEIGHT * (s + 1))
        system.append(forecast, forecast.prior + misfit[rows])
        dense[rows, voxels] = values.T
    monkeypatch.setattr(system._kernel, "solve", lambda right_side: right_side)
    return system, dense, misfit


@pytest.mark.parametrize("weight", [1.0, 1e3])
def test_directions_are_conjugate(coarse, weight, monkeypatch):
    """Without a factor: twelve rows in as many steps, and few more for rounding."""
    system, D, d0 = measured(coarse, weight, monkeypatch)
    n = len(d0)
    monkeypatch.setattr(dual_recursion, "FIELD_ROUNDS", n + 4)
    shift = system.field() - system.prior_field
    G = np.linalg.solve(coarse.L.toarray().T, D.T)
    y = np.linalg.solve(np.eye(n) + G.T @ G, d0)
    size = np.linalg.norm(d0)
    np.testing.assert_allclose(system._y, y, atol=2.0 * FIELD_RTOL * size)
    exact = np.linalg.solve(coarse.L.toarray(), G @ y)
    np.testing.assert_allclose(shift, exact, atol=1e-6 * np.abs(exact).max())
    # from there on nothing is left to do
    held, dual = system._shift, system._y
    system.field()
    assert system._shift is held and system._y is dual


def test_too_few_rounds_say_what_is_left(coarse, monkeypatch):
    system, D, d0 = measured(coarse, 1e3, monkeypatch)
    monkeypatch.setattr(dual_recursion, "FIELD_ROUNDS", 2)
    told = system._refined()
    left = np.linalg.norm(d0 - D @ system._shift - system._y) / np.linalg.norm(d0)
    assert told == pytest.approx(left)
    assert left > FIELD_RTOL
    monkeypatch.setattr(dual_recursion, "FIELD_ROUNDS", 0)
    with pytest.raises(NumericalError, match="dual residual stays at"):
        system.field()
