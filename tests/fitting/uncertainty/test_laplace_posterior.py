"""Covariance and draws of a field's error against dense algebra, on few voxels."""

import functools
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
import scipy.sparse as sp

from tests.kit import small_scene
from ttus_opt.fitting.uncertainty import laplace_posterior
from ttus_opt.fitting.uncertainty.wrench_noise import ErrorModel
from ttus_opt.problem.formulation import load
from ttus_opt.solvers.dual.data import DualData

SCENE = small_scene("trilinear", shape=(5, 8, 6), n_poses=4)
V = SCENE.n_voxels
VARIANCE = 0.3


def errors_of(n_rows):
    """Errors of single rows, and some that rows share."""
    rng = np.random.default_rng(0)
    shared = rng.normal(0.0, 0.2, (n_rows, 14)) * (rng.uniform(size=(n_rows, 14)) < 0.5)
    own = np.tril(rng.normal(0.0, 0.3, (n_rows, n_rows)), 0) + 0.5 * np.eye(n_rows)
    return ErrorModel(VARIANCE, sp.csr_array(np.hstack([own, shared])))


@functools.cache
def made(scale=False):
    """The posterior, its weighted rows D and what dense algebra says of the error."""
    weights = {"force_weight": 40.0, "torque_weight": 5.0}
    data = DualData.of(load("eq10", SCENE, **weights).compile())
    root = data.system.root_weights
    with patch.object(laplace_posterior, "MISSING", 1e-8):  # a basis of all there is
        bare = laplace_posterior.LaplacePosterior.of(data, scale)
    errors = errors_of(int(bare.informative.sum()))
    D = (root[:, None] * data.system.rows.toarray())[bare.informative]
    inverse = np.linalg.inv(SCENE.L.toarray())
    C = inverse @ inverse.T
    if scale:
        p0 = laplace_posterior.SCALE_DEVIATION * inverse @ SCENE.b
        C = C + np.outer(p0, p0)
    G = C @ D.T @ np.linalg.inv(np.eye(len(D)) + D @ C @ D.T)
    left = np.eye(V) - G @ D
    exact = (
        VARIANCE * left @ C @ left.T + G @ (errors.root @ errors.root.T).toarray() @ G.T
    )
    return bare.with_errors(errors), D, exact


def some_rows():
    """Four blocks of three rows, one of them empty."""
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(12, V)) * (rng.uniform(size=(12, V)) < 0.05)
    rows[3:6] = 0.0
    return sp.csr_array(rows)


@pytest.mark.parametrize("scale", [False, True], ids=["known scale", "fitted scale"])
def test_covariance_is_that_of_dense_algebra(scale):
    posterior, _, exact = made(scale)
    rows = some_rows().toarray()
    found = posterior.covariance(some_rows(), 3)
    for k in range(4):
        own = rows[3 * k : 3 * k + 3]
        expected = own @ exact @ own.T
        size = np.sqrt(np.outer(np.diag(expected), np.diag(expected))) + 1e-300
        np.testing.assert_allclose(found[k] / size, expected / size, atol=1e-4)
    assert not found[1].any()


def test_the_mean_given_measurements_is_the_minimiser():
    """Two solves and no fields, for draws where the basis is not kept."""
    posterior, D, _ = made()
    said = np.random.default_rng(1).normal(size=len(D))
    elsewhere = replace(posterior, voxels=np.arange(3))
    (found,) = elsewhere._estimate(said[None], None)
    L = SCENE.L.toarray()
    expected = np.linalg.solve(L.T @ L + D.T @ D, D.T @ said)
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize("scale", [False, True], ids=["known scale", "fitted scale"])
def test_draws_have_the_covariance(scale):
    """400 draws: √ of a mean of squares is off by 1/√800."""
    posterior, _, exact = made(scale)
    draws = posterior.draw(400)[0].astype(float)
    assert draws.shape == (400, V)
    std = np.sqrt(np.diag(exact))
    ratio = np.sqrt((draws**2).mean(axis=0)) / std
    assert abs(np.median(ratio) - 1.0) < 0.03
    assert np.abs(ratio - 1.0).max() < 0.2
    rows = some_rows().toarray()[:3]
    stated = posterior.covariance(some_rows(), 3)[0]
    found = (draws @ rows.T).T @ (draws @ rows.T) / 400
    assert np.abs(found - stated).max() < 0.25 * stated.max()


def test_blocks_that_touch_other_voxels_are_not_known():
    posterior, _, _ = made()
    voxels = np.arange(V // 2)
    few = replace(posterior, fields=posterior.fields[:, voxels], voxels=voxels)
    rows = np.zeros((4, V))
    rows[[0, 1], [3, 5]] = 1.0
    rows[2, 4], rows[3, V - 1] = 1.0, 1.0
    found = few.covariance(sp.csr_array(rows), 2)
    assert np.isnan(found[1]).all()
    whole = posterior.covariance(sp.csr_array(rows), 2)
    np.testing.assert_allclose(found[0], whole[0], rtol=1e-9)
