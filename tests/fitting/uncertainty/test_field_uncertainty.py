"""Covariance of errors against dense algebra, draws, and fits of perturbed data."""

import functools
import pickle
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.stats

import ttus_opt as tt
from tests.fitting.uncertainty import test_wrench_noise
from tests.kit import (
    InputError,
    TtusWarning,
    presses,
    refuses,
    small_scene,
    three_presses,
    torso,
    with_wrenches,
)
from ttus_opt.contact.scene import Scene
from ttus_opt.fitting.uncertainty.field_uncertainty import uncertainty
from ttus_opt.fitting.uncertainty.laplace_posterior import SCALE_DEVIATION
from ttus_opt.fitting.uncertainty.wrench_noise import PRIORS

FORCE, TORQUE = 30.0, 3.0

#: Of these three places the share of a place keeps its prior, and a warning says so
KEPT_SHARE = "ignore:uncertainty. the recordings do not tell errors of whole places"


@functools.cache
def fitted():
    return tt.fit(three_presses(), "eq10", force_weight=FORCE, torque_weight=TORQUE)


@functools.cache
def exact():
    with pytest.warns(TtusWarning, match="errors of whole places"):
        return uncertainty(fitted(), three_presses())


@functools.cache
def unseen():
    return presses(torso(), 5, np.random.default_rng(7))


def wrench_rows(scene, trajectory):
    """Six rows per frame, one frame after the other."""
    there = Scene.assemble(
        scene.voxmap, scene.shell, trajectory, inner=1.0, sampling=scene.sampling
    )
    T, V = len(trajectory), scene.n_voxels
    parts = [m.toarray().reshape(T, 3, V) for m in (there.N, there.W)]
    return np.concatenate(parts, axis=1).reshape(6 * T, V)


def noise_of(found):
    """Covariance of the errors of force and torque over ℓ, by dense algebra."""
    scene = found.scene
    wrench = np.hstack(
        [
            (M @ found.potential.values.ravel()).reshape(-1, 3)
            for M in (scene.N, scene.W)
        ]
    )
    T = len(wrench)
    place = scene.places
    whole = test_wrench_noise.dense(found.noise, wrench, place)
    order = np.arange(6 * T).reshape(T, 2, 3).transpose(1, 0, 2).ravel()
    scale = np.repeat([1.0, 1.0 / scene.torque_length], 3 * T)
    return np.asarray(whole[np.ix_(order, order)] * np.outer(scale, scale))


def dense_errors(C, found):
    """(1 - G D) v C (1 - G D)ᵀ + G Σ Gᵀ, C the covariance of the field's prior."""
    scene = found.scene
    D = np.vstack([scene.N.toarray(), scene.W.toarray() / scene.torque_length])
    w = np.repeat((FORCE, TORQUE), len(D) // 2)
    G = C @ D.T @ np.linalg.inv(np.diag(1.0 / w) + D @ C @ D.T)
    left = np.eye(len(C)) - G @ D
    return np.asarray(found.variance * left @ C @ left.T + G @ noise_of(found) @ G.T)


def of_model(found, trajectory):
    """Errors of the model at places of their own, six rows per frame."""
    wrench = wrench_rows(found.scene, trajectory) @ found.potential.values.ravel()
    frames = len(trajectory)
    noise = replace(found.noise, force=0.0, share=0.0, torque=0.0)
    return test_wrench_noise.dense(noise, wrench.reshape(-1, 6), np.arange(frames))


def of_field(found):
    """Errors of the field alone in unseen frames, shape (5, 6, 6)."""
    return found.covariance(sp.csr_array(wrench_rows(found.scene, unseen())), 6)


def laplace_covariance(scene):
    """(LᵀL)⁻¹."""
    L = scene.L.toarray()
    return np.linalg.inv(L.T @ L)


@pytest.mark.slow
def test_covariance_is_that_of_dense_algebra():
    scene = three_presses()
    rows = wrench_rows(scene, unseen())
    expected = rows @ dense_errors(laplace_covariance(scene), exact()) @ rows.T
    expected += of_model(exact(), unseen())
    found = exact().std(unseen())
    for t in range(5):
        block = expected[6 * t : 6 * t + 6, 6 * t : 6 * t + 6]
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
@pytest.mark.filterwarnings(KEPT_SHARE)
def test_draws_agree_with_it():
    drawn = uncertainty(fitted(), three_presses(), method="samples")
    ratio = drawn.std(unseen()).force_size / exact().std(unseen()).force_size
    np.testing.assert_allclose(ratio, 1.0, atol=0.2)
    std = np.sqrt(np.diag(dense_errors(laplace_covariance(three_presses()), exact())))
    found = exact().potential_std().reshape(-1)
    assert np.median(np.abs(found / std - 1.0)) < 0.06


@pytest.mark.slow
@pytest.mark.filterwarnings(KEPT_SHARE)
def test_draws_where_the_basis_is_not_kept_are_the_same():
    near = uncertainty(fitted(), three_presses(), method="samples", depth=0.001)
    deeper, whole = near.draws(4, 0.05), exact().draws(4, 0.05)
    assert len(deeper.voxels) > len(near.draws(4, 0.001).voxels)
    off = np.abs(deeper.values - whole.values).max()
    assert off < 0.05 * whole.values.std()


@pytest.mark.slow
def test_prior_and_noise_are_the_likeliest():
    found = exact()
    scene, C = found.scene, laplace_covariance(found.scene)
    touching = np.tile(np.repeat(scene.rows.contact_points > 0, 3), 2)
    D = np.vstack([scene.N.toarray(), scene.W.toarray() / scene.torque_length])[
        touching
    ]
    t = np.concatenate([scene.f, scene.tau / scene.torque_length])[touching]
    misfit = t - D @ np.linalg.solve(scene.L.toarray(), scene.b)

    def log_posterior(other):
        """But for a constant."""
        noise = noise_of(other)[np.ix_(touching, touching)]
        density = scipy.stats.multivariate_normal(
            cov=other.variance * D @ C @ D.T + noise
        )
        steps = [
            np.log(getattr(other.noise, name) / median) / spread
            for name, (median, spread) in PRIORS.items()
        ]
        return float(density.logpdf(misfit) - 0.5 * np.sum(np.square(steps)))

    best = log_posterior(found)
    assert found.noise.place_share == PRIORS["place_share"][0]
    for name in PRIORS.keys() - {"place_share"}:
        for factor in (0.5, 2.0):
            value = factor * getattr(found.noise, name)
            other = replace(found, noise=replace(found.noise, **{name: value}))
            assert log_posterior(other) < best + 0.3, name


@pytest.mark.slow
def test_fits_of_perturbed_data_scatter_as_stated():
    scene, rng = three_presses(), np.random.default_rng(3)
    L, rows = scene.L.toarray(), wrench_rows(scene, unseen())
    prior = np.sqrt(exact().variance)
    factor = np.linalg.cholesky(noise_of(exact()))
    ell, errors = scene.torque_length, []
    fitter = None
    for _ in range(40):
        p = np.linalg.solve(L, scene.b + prior * rng.normal(size=len(scene.b)))
        e = factor @ rng.normal(size=len(factor))
        force = scene.N @ p + e[: len(scene.f)]
        torque = scene.W @ p + ell * e[len(scene.f) :]
        drawn = with_wrenches(scene, force, torque)
        weights = {"force_weight": FORCE, "torque_weight": TORQUE}
        given = tt.load_formulation("eq10", drawn, **weights)
        if fitter is None:
            fitter = tt.Fitter(given, solver="structured")
        else:
            fitter.update(given)
        errors.append(rows @ (fitter.solve().candidate - p))
    stated = of_field(exact())
    found = np.mean(np.square(errors), axis=0).reshape(5, 6)
    ratio = found / np.einsum("tii->ti", stated)
    # the mean of 40 squares of a normal number is off by 22 %
    assert np.abs(ratio - 1.0).max() < 0.9 and abs(ratio.mean() - 1.0) < 0.2


@pytest.mark.slow
def test_a_fitted_scale_is_doubted_too():
    scene = three_presses()
    own = Scene.assemble(scene.voxmap, scene.shell, scene.trajectory, inner="fit")
    given = own.with_boundary(own.inner, own.outer)
    weights = {"force_weight": FORCE, "torque_weight": TORQUE}
    with pytest.warns(TtusWarning, match="errors of whole places"):
        free, fixed = (
            uncertainty(tt.fit(s, "eq10", **weights), s) for s in (own, given)
        )
    more, less = (
        np.sqrt(np.einsum("tii->t", of_field(one)[:, :3, :3]))
        for one in (free, replaced(fixed, free))
    )
    assert (more > less).all()
    # a column of its own with a flat prior, in dense algebra
    p0 = SCALE_DEVIATION * np.linalg.solve(own.L.toarray(), own.b)
    errors = dense_errors(laplace_covariance(own) + np.outer(p0, p0), free)
    rows = wrench_rows(own, unseen())
    expected = np.einsum("iv,vw,iw->i", rows, errors, rows)
    size = np.sqrt(expected.reshape(5, 6)[:, :3].sum(axis=1))
    np.testing.assert_allclose(more, size, rtol=0.03)


def replaced(given, other):
    """One with the prior and the noise of another."""
    errors = other._posterior.errors
    return replace(given, _posterior=replace(given._posterior, errors=errors))


def test_one_press_is_enough():
    scene = small_scene("trilinear")
    found = uncertainty(tt.fit(scene, "eq10"), scene)
    assert found.variance > 0.0 and found.noise.force > 0.0
    assert (found.std(scene.trajectory).force_noise > 0.0).all()


def test_a_solution_is_pickled_with_its_scene():
    copied = pickle.loads(pickle.dumps((three_presses(), fitted())))
    with pytest.warns(TtusWarning, match="errors of whole places"):
        found = uncertainty(copied[1], copied[0]).std(unseen()).force
    np.testing.assert_array_equal(found, exact().std(unseen()).force)
    alone = pickle.loads(pickle.dumps(fitted()))
    refuses(InputError, "pickle both as one", uncertainty, alone, three_presses())


def test_what_has_no_such_posterior_is_refused():
    scene, own = three_presses(), fitted()
    for given, at, told in (
        (tt.fit(scene, "robust"), scene, "no uncertainty for robust"),
        (tt.fit(scene, "laplace_only"), scene, "measured terms"),
        (own, small_scene("trilinear", n_poses=3), "another scene"),
        (tt.Renderer(own.field, scene.shell), scene, "comparators have no uncertainty"),
    ):
        refuses(InputError, told, uncertainty, given, at)
    refuses(InputError, "rows must be", exact().covariance, sp.csr_array((5, 7)))
    refuses(InputError, "number above 1", exact().draws, 1)
    for depth in (0.0, np.nan, np.inf):
        refuses(InputError, "depth must be", exact().draws, 5, depth)
        refuses(InputError, "depth must be", uncertainty, own, scene, depth=depth)
    refuses(InputError, "exact or samples", uncertainty, own, scene, method="sample")
