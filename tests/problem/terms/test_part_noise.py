"""Errors by parts, against components taken by hand and dense factors."""

from dataclasses import replace

import numpy as np
import pytest

from tests.kit import InputError, small_scene
from ttus_opt.problem.formulation import load
from ttus_opt.problem.terms.part_noise import (
    EARLIER,
    PartNoise,
    contact_directions,
    independent,
)
from ttus_opt.problem.terms.structure import Whitened, declared
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm

SCENE = small_scene("contact-size", n_poses=60)
T = len(SCENE.trajectory)
TOUCHING = SCENE.rows.contact_points > 0
RNG = np.random.default_rng(0)
OWN, FORCE = RNG.uniform(0.1, 0.5, T), RNG.uniform(0.0, 8.0, T)
DRIFT = RNG.uniform(0.2, 1.0, T)
ZERO = np.zeros(T)


def test_residuals_are_divided_part_by_part():
    """s along the contact; across it and for torque also 0.2 rad of the force."""
    noise = PartNoise.of(SCENE, OWN, FORCE, ZERO)
    assert noise.level == pytest.approx(np.sqrt(np.mean(OWN[TOUCHING] ** 2)))
    p = np.random.default_rng(1).normal(size=SCENE.n_voxels)
    e = (SCENE.N @ p - SCENE.f).reshape(-1, 3)
    along = np.einsum("ti,ti->t", e, noise.direction)
    across = np.einsum("ti,ti->t", e, e) - along**2
    turned = OWN**2 + (0.2 * FORCE) ** 2
    expected = noise.level**2 * (along**2 / OWN**2 + across / turned)
    rows = ForceTerm(SCENE, noise=noise).assembled
    found = (rows.blocks["p"] @ p - rows.target).reshape(-1, 3)
    np.testing.assert_allclose((found**2).sum(axis=1)[TOUCHING], expected[TOUCHING])
    torque = (SCENE.W @ p - SCENE.tau).reshape(-1, 3) / SCENE.torque_length
    rows = TorqueTerm(SCENE, noise=noise).assembled
    found = (rows.blocks["p"] @ p - rows.target).reshape(-1, 3)
    expected_torque = noise.level * torque / np.sqrt(turned)[:, None]
    np.testing.assert_allclose(found, expected_torque)


def test_equal_parts_are_the_plain_term():
    noise = PartNoise.of(SCENE, np.full(T, 0.3), ZERO, ZERO)
    assert noise.level == pytest.approx(0.3)
    for term in (ForceTerm, TorqueTerm):
        plain, same = term(SCENE).assembled, term(SCENE, noise=noise).assembled
        assert abs(plain.blocks["p"] - same.blocks["p"]).max() < 1e-12
        np.testing.assert_allclose(plain.target, same.target)
        found = [declared(rows.tags, Whitened) for rows in (plain, same)]
        assert found[1] is not None and (found[0] is None) == (term is ForceTerm)
        if found[0] is not None:
            assert abs(found[0].by - found[1].by).max() < 1e-12


def covariance(time, recording):
    """That of normal residuals by its definition, (T, T)."""
    late = np.exp(-np.abs(time[:, None] - time)) * (recording[:, None] == recording)
    touching = TOUCHING[:, None] & TOUCHING
    own = np.where(TOUCHING, OWN, 1.0)
    return np.asarray(np.diag(own**2) + late * touching * np.outer(DRIFT, DRIFT))


def timed(step, n_recordings):
    """The poses at even times in recordings of equal length, and the covariance."""
    recording = np.arange(T) * n_recordings // T
    time = step * np.arange(T, dtype=float)
    poses = replace(SCENE.trajectory, time=time, segment=recording)
    return poses, covariance(time, recording)


def test_few_frames_have_the_factor_of_dense_algebra():
    """Where the earlier frames of a recording are all among those that predict."""
    poses, expected = timed(0.05, T // 4)
    assert EARLIER[2] == 3
    found = independent(replace(SCENE, trajectory=poses), OWN, DRIFT).toarray()
    factor = np.linalg.cholesky(expected)
    np.testing.assert_allclose(found @ factor, np.eye(T), atol=1e-10)


def test_of_many_frames_little_is_left_that_they_share():
    poses, expected = timed(0.05, 1)
    found = independent(replace(SCENE, trajectory=poses), OWN, DRIFT).toarray()
    assert not np.triu(found, 1).any()
    left = found @ expected @ found.T
    shared = expected / np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(np.diag(left), 1.0)
    assert np.abs(shared - np.eye(T)).max() > 0.8
    assert np.abs(left - np.eye(T)).max() < 0.2


def test_errors_end_with_a_recording():
    poses, _ = timed(0.05, 2)
    found = independent(replace(SCENE, trajectory=poses), OWN, DRIFT).toarray()
    assert not found[T // 2 :, : T // 2].any() and found[T // 2 :, T // 2 :].any()


def test_a_faster_recording_of_the_same_motion_tells_no_more():
    """Below 20 frames a second each counts as one, above they share its weight."""
    own, force, none = np.full(T, 0.1), np.full(T, 2.0), np.zeros(T)
    told = []
    for step in (1.0, 0.05, 0.01, 0.002):
        poses, _ = timed(step, 1)
        noise = PartNoise.of(replace(SCENE, trajectory=poses), own, force, none)
        assert noise.level == pytest.approx(0.1)
        told.append((noise.normal.diagonal()[0] ** 2, noise.across[0] ** -2.0))
    few = np.array(told)
    np.testing.assert_allclose(few[:, 0] / few[0, 0], [1.0, 1.0, 0.2, 0.04], rtol=1e-9)
    np.testing.assert_allclose(few[:, 1] / few[0, 1], [1.0, 1.0, 0.2, 0.04], rtol=1e-9)


def test_eq10_with_errors_of_directions_has_these_rows():
    """0.05 N and 3 % of the measured normal force, across it 0.3 rad more."""
    assert PartNoise.of_direction(SCENE, None) is None
    u = contact_directions(SCENE)
    m = np.maximum(np.einsum("ti,ti->t", u, SCENE.f.reshape(-1, 3)), 0.0)
    own = np.sqrt(0.05**2 + (0.03 * m) ** 2)
    noise = PartNoise.of(SCENE, own, m, ZERO, 0.3)
    across = np.sqrt(own**2 + (0.3 * m) ** 2) / noise.level
    np.testing.assert_allclose(noise.across, across)
    declared = load("eq10", SCENE, direction_error=0.3)
    for term in declared.terms[1:]:
        expected = replace(term, noise=noise).assembled
        assert abs(term.assembled.blocks["p"] - expected.blocks["p"]).max() < 1e-12
    dragged = load("coulomb_global", SCENE, direction_error=0.3)
    noises = [getattr(term, "noise", None) for term in dragged.terms]
    assert sum(one is not None for one in noises) == 2
    for wrong in (-0.1, np.nan, np.inf):
        with pytest.raises(InputError, match="direction_error must not be negative"):
            PartNoise.of_direction(SCENE, wrong)
