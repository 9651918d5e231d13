"""The closed form of a depth map's posterior against dense algebra."""

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
from tests.fitting.uncertainty.test_field_uncertainty import exact as laplace
from tests.kit import ellipsoid, presses, torso
from ttus_opt.fitting.uncertainty import covariance_posterior
from ttus_opt.fitting.uncertainty.covariance_posterior import FACTORS
from ttus_opt.fitting.uncertainty.wrench_noise import LEAST_SHARE, MeasuredWrenches
from ttus_opt.gaussian.matern import VoxelColumns
from ttus_opt.problem.terms.depth_profile import voxel_depths

pytestmark = pytest.mark.filterwarnings(KEPT_SHARE)

WEIGHTS = {"force_weight": 30.0, "torque_weight": 3.0}


#: ℓ₀ of the sampling, and the same a step further, to three digits as in its name
LEAST, STEP = 0.01, 0.01


@functools.cache
def scene_of(least):
    return three_presses().resampled(f"contact-size:{least:.3g}")


@functools.cache
def fitted():
    return tt.fit(scene_of(LEAST), "depth_map", **WEIGHTS)


@functools.cache
def exact():
    return tt.uncertainty(fitted(), scene_of(LEAST))


def rows_of(scene):
    return np.vstack([scene.N.toarray(), scene.W.toarray() / scene.torque_length])


def per_size(rows_of, values):
    """Change of what scenes' rows have of a field per ln ℓ₀, by differences."""
    more, less = (rows_of(scene_of(LEAST * (1.0 + s))) for s in (STEP, -STEP))
    return np.asarray((more - less) @ values / (2.0 * np.arctanh(STEP)))


def dense(rows, sized):
    """Covariance of the errors of rows, the prior's by its term's own matrix."""
    prior = next(t for t in fitted().program.terms if t.known_covariance)
    R = np.sqrt(prior.weight) * prior.matrix.toarray()
    C, scene = np.linalg.inv(R.T @ R), scene_of(LEAST)
    by = [  # what the rows of each frame are multiplied by
        np.sqrt(term.weight)
        * by.toarray()
        * (scene.torque_length if term.name == "torque" else 1.0)
        for term in fitted().program.terms
        if (by := term.whitening) is not None
    ]
    mixed = scipy.linalg.block_diag(*by)
    D = mixed @ rows_of(scene)
    found, mean = exact(), prior.known_covariance.mean
    profile = C @ R.T @ (np.sqrt(prior.weight) * prior.target)
    # relative to the fit: all errors times p̂/φ, those of the rows over theirs
    factor = np.clip(found.potential.values.ravel() / profile, *FACTORS)
    size = mean.size_deviation * mixed @ per_size(rows_of, profile)
    seen = np.column_stack([D @ mean.drift, size])
    told = seen.T @ np.linalg.solve(np.eye(len(D)) + D @ C @ D.T, seen)
    rows = rows * factor
    gain = rows @ C @ D.T @ np.linalg.inv(np.eye(len(D)) + D @ C @ D.T)
    drift = np.column_stack([rows @ mean.drift, mean.size_deviation * sized])
    drift = drift - gain @ seen
    left = rows - gain @ D
    own = left @ C @ left.T
    own += drift @ np.linalg.inv(np.eye(len(told)) + told) @ drift.T
    # of the noise of whole places only their relative error, beside that of the fit
    turnless = replace(found.noise, force=0.0, torque=0.0, share=0.0, turn=0.0, shift=0)
    place = mixed @ noise_of(replace(found, noise=turnless)) @ mixed.T
    data = mixed @ np.concatenate([scene.f, scene.tau / scene.torque_length])
    rest = data - D @ profile
    told = np.any(D != 0.0, axis=1)
    rest[~told] = 0.0
    square = rest @ np.linalg.solve(np.eye(len(D)) + D @ C @ D.T, rest) / told.sum()
    noise = max(square, 1.0) * np.eye(len(D)) + place
    size = np.abs(D) * np.abs(profile)
    gain[:, told] /= (size @ factor)[told] / size.sum(axis=1)[told]
    return np.asarray(found.variance * own + gain @ noise @ gain.T)


def unseen_rows():
    """Rows of unseen wrenches, and their change per ln ℓ₀."""
    values = exact().potential.values.ravel()
    sized = per_size(lambda scene: wrench_rows(scene, unseen()), values)
    return wrench_rows(scene_of(LEAST), unseen()), sized


@pytest.mark.slow
def test_covariance_is_that_of_dense_algebra():
    expected = dense(*unseen_rows()) + of_model(exact(), unseen())
    expected = expected.reshape(5, 6, 5, 6)
    stated = exact().std(unseen()).covariance
    assert exact().method == "exact" and stated[0, 0, 0] > 0.0
    for t in range(5):
        block = expected[t, :, t]
        size = np.sqrt(np.outer(np.diag(block), np.diag(block)))
        np.testing.assert_allclose(stated[t] / size, block / size, atol=1e-5)


def test_a_root_of_the_rows_is_as_good_as_one_of_the_voxels(monkeypatch):
    """That of all touched voxels does not fit in memory on fine grids."""
    scene = scene_of(LEAST)
    among = exact()._posterior
    monkeypatch.setattr(covariance_posterior, "DENSE", 10)
    monkeypatch.setattr(covariance_posterior, "AT_ONCE", 7)
    monkeypatch.setattr(VoxelColumns, "among", property(lambda _: pytest.fail("n × n")))
    found = tt.uncertainty(fitted(), scene)
    K = among.images.T @ among.images
    images = found._posterior.images
    assert abs(images.T @ images - K).max() < 1e-10 * K.max()
    assert len(images) <= min(K.shape)
    stated, known = found.std(unseen()), exact().std(unseen())
    size = abs(known.covariance).max()
    np.testing.assert_allclose(
        stated.covariance, known.covariance, rtol=1e-8, atol=1e-9 * size
    )
    assert found.noise.as_dict() == pytest.approx(exact().noise.as_dict(), rel=1e-6)
    np.testing.assert_allclose(
        found.draws(4).values, exact().draws(4).values, rtol=1e-4, atol=1e-6
    )


@pytest.mark.slow
def test_all_rows_at_once_are_those_of_dense_algebra():
    rows, sized = unseen_rows()
    expected = dense(rows, sized)
    found = exact().covariance(sp.csr_array(rows), len(rows), sized)[0]
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / size, expected / size, atol=1e-5)


@pytest.mark.slow
def test_draws_agree_with_it():
    drawn = exact().sampled(count=400)
    ratio = drawn.std(unseen()).force_size / exact().std(unseen()).force_size
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)
    size = np.sqrt(exact().variance) * np.linalg.norm(exact()._posterior.size)
    assert np.std(drawn.draws(400).sizes) == pytest.approx(size, rel=0.1)
    voxels = np.eye(three_presses().n_voxels)
    std = np.sqrt(np.diag(dense(voxels, np.zeros(len(voxels)))))
    found = exact().potential_std().reshape(-1)
    assert abs(np.median(found / std) - 1.0) < 0.02


def opposite_presses():
    """The same presses on both sides of a torso, of which one is twice as stiff."""
    surface = torso()
    voxmap = tt.Voxmap.from_surface(surface, shape=(9, 20, 10))
    rng, turn = np.random.default_rng(0), np.diag([-1.0, -1.0, 1.0])
    one = presses(surface, 8, rng, depth=0.015)
    other = replace(one, position=one.position @ turn, rotation=turn @ one.rotation)
    both = tt.Trajectory.concatenate([one, other])
    scene = tt.Scene.assemble(voxmap, ellipsoid(), both, inner=1.0)
    shape = voxmap.grid.shape
    stiff = np.where(np.arange(shape[1]) < shape[1] // 2, 2.0, 1.0)
    depth = np.maximum(voxel_depths(voxmap), 0.0).reshape(shape)
    p = (60.0 * depth * stiff[:, None]).reshape(-1)
    force = (scene.N @ p).reshape(-1, 3) + rng.normal(0.0, 0.02, both.position.shape)
    torque = (scene.W @ p).reshape(-1, 3)
    measured = replace(both, force=force, torque=torque)
    return tt.Scene.assemble(voxmap, ellipsoid(), measured, inner=1.0)


def test_a_stiffer_place_is_uncertain_by_more_newtons():
    """Beside the presses, whose geometry is the same, by the same share of the force.

    A field that varies by an amount, not by a factor, is uncertain alike on both sides.
    """
    scene = opposite_presses()
    solution = tt.fit(scene, "depth_map", **WEIGHTS)
    found = tt.uncertainty(solution, scene)
    voxels = sp.csr_array(sp.eye_array(scene.n_voxels))
    std = np.sqrt(found.covariance(voxels, 1)[:, 0, 0])
    inside = voxel_depths(scene.voxmap) > 0.0
    share = np.where(inside, std / solution.field.values.reshape(-1), np.nan)
    (stiff, soft), (more, less) = (
        np.split(scene.voxmap.grid.unflatten(values), 2, axis=1)
        for values in (share, np.where(inside, std, np.nan))
    )
    assert np.nanmax(more / less) > 1.5
    assert np.nanmedian(np.abs(np.log(stiff / soft))) < 0.02
    assert np.nanmax(np.abs(np.log(stiff / soft))) < 0.25  # by the noise


def test_errors_of_places_are_told_of_the_usual_force():
    """A depth map's, of the forces it renders in contact; not of a Laplace field."""
    scene = scene_of(LEAST)
    rendered = (scene.N @ fitted().field.values.reshape(-1)).reshape(-1, 3)
    square = np.sum(rendered[scene.touching] ** 2, axis=1).mean()
    assert exact().noise.usual_force == pytest.approx(np.sqrt(square), rel=1e-6)
    assert np.isnan(laplace().noise.usual_force)


def test_a_place_of_a_depth_map_is_never_exact(monkeypatch):
    """However little its places differ from it; a Laplace field's may be."""
    exactly = replace(exact().noise, place_share=0.001)
    monkeypatch.setattr(MeasuredWrenches, "estimate", lambda *_: (1.0, exactly))
    assert tt.uncertainty(fitted(), scene_of(LEAST)).noise.place_share == LEAST_SHARE
    plain = tt.fit(three_presses(), "eq10", **WEIGHTS)
    assert tt.uncertainty(plain, three_presses()).noise.place_share == 0.001


def test_forces_without_torques_have_an_uncertainty_too():
    """A depth map of them has no torque rows; torques tell more."""
    whole = opposite_presses()
    bare = replace(whole.trajectory, torque=None)
    scene = tt.Scene.assemble(whole.voxmap, whole.shell, bare, inner=1.0)
    found = tt.uncertainty(tt.fit(scene, "depth_map", force_weight=30.0), scene)
    rows = sp.csr_array(whole.N)
    less = tt.uncertainty(tt.fit(whole, "depth_map", **WEIGHTS), whole)
    assert np.isnan(found.noise.torque)
    seen = whole.touching
    stated, known = (np.trace(u.covariance(rows, 3).T)[seen] for u in (found, less))
    assert np.median(stated / known) > 1.0
    assert (stated > 0.0).all()
