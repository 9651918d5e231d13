"""Conjugate gradients of the dual system against its dense solution."""

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.fitting.recursion import field_refinement
from ttus_opt.fitting.recursion.field_refinement import FIELD_RTOL, refined
from ttus_opt.fitting.recursion.low_rank_kernel import LowRankKernel
from ttus_opt.fitting.recursion.measured_rows import Block, MeasuredRows
from ttus_opt.gaussian.laplace_prior import LaplacePrior

HEIGHT, BLOCKS = 3, 4


class Unpreconditioned(LowRankKernel):
    """No factor at all: R = 0."""

    def solve(self, right_side):
        return right_side


@pytest.fixture(scope="module")
def coarse():
    return small_scene(shape=(7, 12, 7), n_poses=2)


def prior_of(scene):
    return LaplacePrior(scene.laplace, np.ones(scene.n_voxels))


def measured(scene, weight):
    """Random local rows, and the same dense."""
    rng, V = np.random.default_rng(12), scene.n_voxels
    rows, dense = MeasuredRows(V, HEIGHT), np.zeros((BLOCKS * HEIGHT, V))
    for s in range(BLOCKS):
        voxels = np.sort(rng.choice(V, 9, replace=False))
        values = rng.normal(size=(9, HEIGHT)) * np.sqrt(weight)
        rows.append(Block(voxels.astype(np.int32), values))
        dense[HEIGHT * s : HEIGHT * (s + 1), voxels] = values.T
    return rows, dense


@pytest.mark.parametrize("weight", [1.0, 1e3])
def test_directions_are_conjugate(coarse, weight, monkeypatch):
    """Without a factor: twelve rows in as many steps, and few more for rounding."""
    rows, D = measured(coarse, weight)
    d0 = np.random.default_rng(13).normal(size=len(D))
    V, n = coarse.n_voxels, len(d0)
    monkeypatch.setattr(field_refinement, "FIELD_ROUNDS", n + 4)
    found = refined(
        prior_of(coarse), rows, Unpreconditioned(), d0, np.zeros(V), np.zeros(n)
    )
    assert found.residual == 0.0
    G = np.linalg.solve(coarse.L.toarray().T, D.T)
    y = np.linalg.solve(np.eye(n) + G.T @ G, d0)
    size = np.linalg.norm(d0)
    np.testing.assert_allclose(found.y, y, atol=2.0 * FIELD_RTOL * size)
    shift = np.linalg.solve(coarse.L.toarray(), G @ y)
    np.testing.assert_allclose(found.shift, shift, atol=1e-6 * np.abs(shift).max())
    # from there on nothing is left to do
    again = refined(
        prior_of(coarse), rows, Unpreconditioned(), d0, found.shift, found.y
    )
    assert again.shift is found.shift and again.y is found.y


def test_too_few_rounds_say_what_is_left(coarse, monkeypatch):
    rows, D = measured(coarse, 1e3)
    d0 = np.random.default_rng(13).normal(size=len(D))
    V, n = coarse.n_voxels, len(d0)
    monkeypatch.setattr(field_refinement, "FIELD_ROUNDS", 2)
    found = refined(
        prior_of(coarse), rows, Unpreconditioned(), d0, np.zeros(V), np.zeros(n)
    )
    left = np.linalg.norm(d0 - D @ found.shift - found.y) / np.linalg.norm(d0)
    assert found.residual == pytest.approx(left)
    assert left > FIELD_RTOL
