"""Posterior covariance against dense algebra, draws, and fits of perturbed data."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

import ttus_opt as tt
from tests.conftest import presses, small_scene, torso
from tests.fitting import test_weight_criteria
from ttus_opt.errors import InputError
from ttus_opt.fitting.doubt import Doubt, doubt
from ttus_opt.fitting.laplace_posterior import SCALE_DEVIATION
from ttus_opt.fitting.weight_criteria import presses as press_numbers
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem.solution import Solution
from ttus_opt.scene import Scene

FORCE, TORQUE = 30.0, 3.0


@functools.cache
def three_presses() -> Scene:
    """Frames in contact with one in the air after every four."""
    return test_weight_criteria.three_presses()


@functools.cache
def fitted() -> Solution:
    return tt.fit(three_presses(), "eq10", force_weight=FORCE, torque_weight=TORQUE)


@functools.cache
def exact() -> Doubt:
    return doubt(fitted(), three_presses())


@functools.cache
def unseen() -> Trajectory:
    return presses(torso(), 5, np.random.default_rng(7))


def wrench_rows(scene: Scene, trajectory: Trajectory) -> np.ndarray:
    """Six rows per frame, one frame after the other."""
    there = Scene.assemble(scene.voxmap, scene.shell, trajectory, inner=1.0)
    T, V = len(trajectory), scene.n_voxels
    parts = [m.toarray().reshape(T, 3, V) for m in (there.N, there.W)]
    return np.concatenate(parts, axis=1).reshape(6 * T, V)


def dense_posterior(scene: Scene) -> np.ndarray:
    """(LᵀL + Dᵀ W² D)⁻¹."""
    L, N = scene.L.toarray(), scene.N.toarray()
    W = scene.W.toarray() / scene.torque_length
    return np.linalg.inv(L.T @ L + FORCE * N.T @ N + TORQUE * W.T @ W)


@pytest.mark.slow
def test_covariance_is_that_of_dense_algebra() -> None:
    scene = three_presses()
    rows = wrench_rows(scene, unseen())
    expected = rows @ dense_posterior(scene) @ rows.T
    found = exact().std(unseen())
    for t in range(5):
        block = exact().variance * expected[6 * t : 6 * t + 6, 6 * t : 6 * t + 6]
        scale = np.sqrt(np.outer(np.diag(block), np.diag(block))) + 1e-12
        assert np.abs(found.covariance[t] - block).max() < 0.02 * scale.max()
        np.testing.assert_allclose(
            found.force[t], np.sqrt(np.diag(block))[:3], rtol=0.02
        )
        np.testing.assert_allclose(
            found.torque[t], np.sqrt(np.diag(block))[3:], rtol=0.05
        )
    assert exact().method == "exact"


@pytest.mark.slow
def test_draws_agree_with_it() -> None:
    drawn = doubt(fitted(), three_presses(), method="samples")
    ratio = drawn.std(unseen()).force_size / exact().std(unseen()).force_size
    np.testing.assert_allclose(ratio, 1.0, atol=0.2)
    std = np.sqrt(exact().variance * np.diag(dense_posterior(three_presses())))
    found = exact().potential_std().reshape(-1)
    assert np.median(np.abs(found / std - 1.0)) < 0.06


@pytest.mark.slow
def test_scale_is_that_of_presses_left_out() -> None:
    scene = three_presses()
    L, number = scene.L.toarray(), press_numbers(scene)
    D = np.vstack([scene.N.toarray(), scene.W.toarray() / scene.torque_length])
    t = np.concatenate([scene.f, scene.tau / scene.torque_length])
    w = np.repeat([FORCE, TORQUE], len(t) // 2)
    frame = np.tile(np.repeat(number, 3), 2)
    touching = np.tile(np.repeat(scene.rows.contact_points > 0, 3), 2)
    scores = []
    for one in np.unique(frame[touching]):
        out = (frame == one) & touching
        own, rest = D[out], D[~out]
        P = np.linalg.inv(L.T @ L + rest.T @ (w[~out, None] * rest))
        p = P @ (L.T @ scene.b + rest.T @ (w[~out] * t[~out]))
        variance = np.diag(own @ P @ own.T) + 1.0 / w[out]
        scores.append((t[out] - own @ p) / np.sqrt(variance))
    expected = (np.quantile(np.abs(np.concatenate(scores)), 0.95) / 1.96) ** 2
    assert exact().variance == pytest.approx(expected, rel=0.02)
    assert exact().calibrated_by == "presses left out"
    assert exact().std(unseen()).force_noise == pytest.approx(
        np.sqrt(expected / FORCE), rel=0.02
    )


@pytest.mark.slow
def test_fits_of_perturbed_data_scatter_as_stated() -> None:
    scene, rng = three_presses(), np.random.default_rng(3)
    L, rows = scene.L.toarray(), wrench_rows(scene, unseen())
    ell, errors = scene.torque_length, []
    fitter = None
    for _ in range(40):
        p = np.linalg.solve(L, scene.b + rng.normal(size=len(scene.b)))
        force = scene.N @ p + rng.normal(size=len(scene.f)) / np.sqrt(FORCE)
        torque = scene.W @ p + ell * rng.normal(size=len(scene.f)) / np.sqrt(TORQUE)
        trajectory = replace(
            scene.trajectory, force=force.reshape(-1, 3), torque=torque.reshape(-1, 3)
        )
        given = tt.load_formulation(
            "eq10",
            replace(scene, trajectory=trajectory),
            force_weight=FORCE,
            torque_weight=TORQUE,
        )
        if fitter is None:
            fitter = tt.Fitter(given, solver="structured")
        else:
            fitter.update(given)
        errors.append(rows @ (fitter.solve().candidate - p))
    stated = exact().std(unseen()).covariance / exact().variance
    found = np.mean(np.square(errors), axis=0).reshape(5, 6)
    ratio = found / np.einsum("tii->ti", stated)
    # the mean of 40 squares of a normal number is off by 22 %
    assert np.abs(ratio - 1.0).max() < 0.9 and abs(ratio.mean() - 1.0) < 0.2


@pytest.mark.slow
def test_a_fitted_scale_is_doubted_too() -> None:
    scene = three_presses()
    own = Scene.assemble(scene.voxmap, scene.shell, scene.trajectory, inner="fit")
    given = own.with_boundary(own.inner, own.outer)
    weights = {"force_weight": FORCE, "torque_weight": TORQUE}
    free, fixed = (doubt(tt.fit(s, "eq10", **weights), s) for s in (own, given))
    more, less = (d.std(unseen()).force_size / d.variance**0.5 for d in (free, fixed))
    assert (more > less).all()
    # a column of its own with a flat prior, in dense algebra
    L = own.L.toarray()
    D = np.vstack([own.N.toarray(), own.W.toarray() / own.torque_length])
    w = np.repeat([FORCE, TORQUE], len(D) // 2)
    C = np.linalg.inv(L.T @ L)
    p0 = SCALE_DEVIATION * np.linalg.solve(L, own.b)
    C += np.outer(p0, p0)
    S = np.diag(1.0 / w) + D @ C @ D.T
    rows = wrench_rows(own, unseen())
    cross = rows @ C @ D.T
    expected = rows @ C @ rows.T - cross @ np.linalg.solve(S, cross.T)
    size = np.sqrt(np.diag(expected).reshape(5, 6)[:, :3].sum(axis=1))
    np.testing.assert_allclose(more, size, rtol=0.03)


def test_one_press_is_scaled_by_its_likelihood() -> None:
    scene = small_scene("trilinear")
    found = doubt(tt.fit(scene, "eq10"), scene)
    assert found.calibrated_by == "likelihood" and found.variance > 0.0


def test_what_has_no_such_posterior_is_refused() -> None:
    scene = three_presses()
    with pytest.raises(InputError, match="no doubt of robust"):
        doubt(tt.fit(scene, "robust"), scene)
    with pytest.raises(InputError, match="measured terms"):
        doubt(tt.fit(scene, "laplace_only"), scene)
    with pytest.raises(InputError, match="another scene"):
        doubt(fitted(), small_scene("trilinear", n_poses=3))
    with pytest.raises(InputError, match="rows must be"):
        exact().covariance(sp.csr_array((5, 7)))
    with pytest.raises(InputError, match="count above 1"):
        exact().draws(1)
