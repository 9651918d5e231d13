"""The closed form of a depth map's posterior against dense algebra."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp

import ttus_opt as tt
from tests.fitting.uncertainty.test_field_uncertainty import (
    KEPT_SHARE,
    noise_of,
    of_model,
    three_presses,
    unseen,
    wrench_rows,
)
from ttus_opt.fitting.uncertainty.field_uncertainty import Uncertainty, uncertainty
from ttus_opt.problem.solution import Solution
from ttus_opt.problem.terms.structure import known_covariance, whitening

pytestmark = pytest.mark.filterwarnings(KEPT_SHARE)

WEIGHTS = {"force_weight": 30.0, "torque_weight": 3.0}


@functools.cache
def fitted() -> Solution:
    return tt.fit(three_presses(), "depth_map", **WEIGHTS)


@functools.cache
def exact() -> Uncertainty:
    return uncertainty(fitted(), three_presses())


def dense() -> np.ndarray:
    """Covariance of the errors, the prior's by its term's own matrix."""
    prior = next(t for t in fitted().program.terms if known_covariance(t.tags))
    R = np.sqrt(prior.weight) * prior.matrix.toarray()
    C, scene = np.linalg.inv(R.T @ R), three_presses()
    by = [  # what the rows of each frame are multiplied by
        np.sqrt(term.weight)
        * by.toarray()
        * (scene.torque_length if term.name == "torque" else 1.0)
        for term in fitted().program.terms
        if (by := whitening(term.tags)) is not None
    ]
    mixed = scipy.linalg.block_diag(*by)
    rows = np.vstack([scene.N.toarray(), scene.W.toarray() / scene.torque_length])
    D = mixed @ rows
    G = C @ D.T @ np.linalg.inv(np.eye(len(D)) + D @ C @ D.T) @ mixed
    left = np.eye(len(C)) - G @ rows
    found, mean = exact(), known_covariance(prior.tags).mean
    seen = D @ mean.drift
    told = seen.T @ np.linalg.solve(np.eye(len(D)) + D @ C @ D.T, seen)
    drift = mean.drift @ np.linalg.inv(np.eye(len(told)) + told) @ mean.drift.T
    own = left @ (C + drift) @ left.T
    # of the noise of whole places only their relative error, beside that of the fit
    turnless = replace(found.noise, force=0.0, torque=0.0, share=0.0, turn=0.0, shift=0)
    place = mixed @ noise_of(replace(found, noise=turnless)) @ mixed.T
    data = mixed @ np.concatenate([scene.f, scene.tau / scene.torque_length])
    rest = data - D @ (C @ R.T @ (np.sqrt(prior.weight) * prior.target))
    told = np.any(D != 0.0, axis=1)
    rest[~told] = 0.0
    square = rest @ np.linalg.solve(np.eye(len(D)) + D @ C @ D.T, rest) / told.sum()
    gain = C @ D.T @ np.linalg.inv(np.eye(len(D)) + D @ C @ D.T)
    noise = max(square, 1.0) * np.eye(len(D)) + place
    return np.asarray(found.variance * own + gain @ noise @ gain.T)


@pytest.mark.slow
def test_covariance_is_that_of_dense_algebra():
    rows = wrench_rows(three_presses(), unseen())
    expected = rows @ dense() @ rows.T + of_model(exact(), unseen())
    expected = expected.reshape(5, 6, 5, 6)
    stated = exact().std(unseen()).covariance
    assert exact().method == "exact" and stated[0, 0, 0] > 0.0
    for t in range(5):
        block = expected[t, :, t]
        size = np.sqrt(np.outer(np.diag(block), np.diag(block)))
        np.testing.assert_allclose(stated[t] / size, block / size, atol=1e-6)


@pytest.mark.slow
def test_all_rows_at_once_are_those_of_dense_algebra():
    rows = sp.csr_array(wrench_rows(three_presses(), unseen()))
    expected = rows @ dense() @ rows.T
    found = exact().covariance(rows, rows.shape[0])[0]
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / size, expected / size, atol=1e-5)


@pytest.mark.slow
def test_draws_agree_with_it():
    drawn = exact().sampled(count=400)
    ratio = drawn.std(unseen()).force_size / exact().std(unseen()).force_size
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)
    std = np.sqrt(np.diag(dense()))
    found = exact().potential_std().reshape(-1)
    assert abs(np.median(found / std) - 1.0) < 0.02
