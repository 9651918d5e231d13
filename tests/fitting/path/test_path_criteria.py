"""Criteria along a path against dense algebra and fits with a press left out."""

import numpy as np
import pytest
import scipy.stats

import ttus_opt as tt
from tests.kit import InputError, small_scene, three_presses

FORCE, TORQUE = 30.0, 3.0


def dense(scene):
    """C, misfit and weights of the rows that say something."""
    ell = scene.torque_length
    D = np.vstack([scene.N.toarray(), scene.W.toarray() / ell])
    t = np.concatenate([scene.f, scene.tau / ell])
    told = np.abs(D).sum(axis=1) > 0.0
    G = np.linalg.solve(scene.L.toarray().T, D[told].T)
    d = (t - D @ np.linalg.solve(scene.L.toarray(), scene.b))[told]
    weights = np.repeat([FORCE, TORQUE], len(t) // 2)[told]
    return G.T @ G, d, weights, told


@pytest.fixture(scope="module")
def path():
    return tt.solution_path(
        "eq10",
        three_presses(),
        weights={"force": [0.1, FORCE], "torque": [TORQUE]},
        extras=["criteria"],
    )


def test_evidence_and_gcv_are_those_of_dense_algebra(path):
    C, d, weights, _ = dense(three_presses())
    covariance = np.diag(1.0 / weights) + C
    m = len(d)
    scale = d @ np.linalg.solve(covariance, d) / m
    normal = scipy.stats.multivariate_normal(np.zeros(m), scale * covariance)
    at = path.sel(force_weight=FORCE, torque_weight=TORQUE)
    assert float(at["log_evidence"]) == pytest.approx(normal.logpdf(d), abs=0.3)
    # the hat matrix of the rows as they are, its residual in the rows' own metric
    W = np.diag(np.sqrt(weights))
    R = np.linalg.inv(np.eye(m) + W @ C @ W)
    left = R @ W @ d
    gcv = m * (left @ left) / np.trace(R) ** 2 / np.exp(np.log(weights).mean())
    assert float(at["gcv"]) == pytest.approx(gcv, rel=1e-2)


def test_one_press_cannot_be_left_out():
    scene = small_scene("trilinear")
    path = tt.solution_path(
        "eq10", scene, weights={"force": [1.0]}, extras=["criteria"]
    )
    assert np.isnan(path["left_out_force_error"]).all()
    assert np.isfinite(path["log_evidence"]).all()


def test_an_unknown_extra_is_one_line():
    with pytest.raises(InputError, match="potential or criteria"):
        tt.solution_path(
            "eq10", small_scene("trilinear"), weights={"force": [1.0]}, extras=["all"]
        )
