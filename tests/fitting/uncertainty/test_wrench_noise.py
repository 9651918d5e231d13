"""The noise of measured wrenches against dense algebra and numbers drawn from it."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.stats

from ttus_opt.core.errors import InputError, TtusWarning
from ttus_opt.fitting.uncertainty import wrench_noise
from ttus_opt.fitting.uncertainty.wrench_noise import (
    MOST_SHARE,
    PRIORS,
    MeasuredWrenches,
    WrenchNoise,
)

NOISE = WrenchNoise(0.08, 0.03, 0.06, 0.04, 0.003, 0.002)


def crossed(vector):
    """X with X a = a × vector."""
    x, y, z = vector
    return np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])


def dense(noise, wrench, place):
    """Covariance of the errors of all frames, six after six, (6n, 6n)."""
    n = len(wrench)
    out = np.zeros((n, 6, n, 6))
    share = np.full(n, noise.place_share)
    if noise.usual_force > 0.0:
        size = np.linalg.norm(wrench[:, :3], axis=1)
        share[size > 0.0] *= (noise.usual_force / size[size > 0.0]) ** 0.5
    sensor = [noise.force**2] * 3 + [noise.torque**2] * 3
    for t in range(n):
        out[t, :, t] += np.diag(sensor)
        out[t, :, t] += noise.share**2 * np.outer(wrench[t], wrench[t])
        for u in np.flatnonzero(place == place[t]):
            out[t, :, u] += share[t] * share[u] * np.outer(wrench[t], wrench[u])
            both = crossed(wrench[t, :3]) @ crossed(wrench[u, :3]).T
            out[t, :3, u, :3] += noise.turn**2 * both
            out[t, 3:, u, 3:] += noise.shift**2 * both
    return out.reshape(6 * n, 6 * n)


def recorded(n, n_places, k=5):
    """Wrenches, and measurements drawn with a prior variance of 0.5."""
    rng = np.random.default_rng(4)
    force = rng.normal((4.0, 0.0, 0.0), 1.0, (n, 3))
    force *= rng.uniform(0.1, 2.0, (n, 1))
    wrench = np.hstack([force, 0.01 * rng.normal(size=(n, 3))])
    place = np.repeat(np.arange(n_places), -(-n // n_places))[:n]
    images = rng.normal(size=(k, n, 6)) * ([0.3] * 3 + [3e-3] * 3)
    factor = np.linalg.cholesky(dense(NOISE, wrench, place))
    errors = (factor @ rng.normal(size=6 * n)).reshape(n, 6)
    told = np.einsum("knh,k->nh", images, np.sqrt(0.5) * rng.normal(size=k))
    return MeasuredWrenches(images, told + errors, wrench, place, np.arange(6))


@pytest.mark.parametrize("k", [5, 60])  # fewer fields than measurements, or more
@pytest.mark.parametrize("noise", [NOISE, replace(NOISE, usual_force=6.0)])
def test_density_is_that_of_dense_algebra(noise, k):
    given = recorded(9, 3, k)
    K = given.images.reshape(k, -1)
    covariance = dense(noise, given.wrench, given.place) + 0.7 * K.T @ K
    expected = scipy.stats.multivariate_normal(cov=covariance).logpdf(
        given.misfit.reshape(-1)
    )
    assert given.log_density(0.7, noise) == pytest.approx(expected, rel=1e-9)


def test_the_error_of_a_place_may_grow_with_the_root_of_the_force():
    """It is c of the usual force, and 0 without a force."""
    given = replace(recorded(9, 3), usual_force=4.0)
    found = given.estimate(1.0)[1]
    assert found.usual_force == 4.0
    wrench = np.outer([0.0, 1.0, 4.0, 16.0], [0.0, 0.6, 0.8, 0.0, 0.0, 0.0])
    stated = np.linalg.norm(found.shared(wrench)[:, :, 0], axis=1)
    expected = found.place_share * np.array([0.0, 2.0, 4.0, 8.0])
    np.testing.assert_allclose(stated, expected, rtol=1e-12)


def test_forces_alone_have_the_density_of_their_block():
    whole = recorded(9, 3)
    given = MeasuredWrenches(
        whole.images[..., :3],
        whole.misfit[:, :3],
        whole.wrench,
        whole.place,
        np.arange(3),
    )
    noise = WrenchNoise(NOISE.force, NOISE.share, NOISE.place_share, NOISE.turn)
    force = np.tile(np.arange(6) < 3, 9)
    covariance = dense(NOISE, whole.wrench, whole.place)[np.ix_(force, force)]
    expected = scipy.stats.multivariate_normal(cov=covariance).logpdf(
        given.misfit.reshape(-1)
    )
    assert given.log_density(1e-30, noise) == pytest.approx(expected, rel=1e-9)
    assert np.isnan(given.estimate(1.0)[1].torque)
    stated = noise.covariance(whole.wrench)
    assert np.isfinite(stated[:, :3, :3]).all() and np.isnan(stated[:, 3:]).all()


def test_a_frame_states_the_diagonal_blocks():
    given = recorded(9, 3)
    whole = dense(NOISE, given.wrench, given.place).reshape(9, 6, 9, 6)
    blocks = np.einsum("titj->tij", whole)
    np.testing.assert_allclose(NOISE.covariance(given.wrench), blocks, atol=1e-15)


def test_a_share_just_below_its_limit_is_at_the_limit(monkeypatch):
    """The search ends on either side of the corner: 0.247 for the patient `lean`."""
    asked = []

    def likeliest(given, priors, held):
        asked.append(held)
        return 1.0, replace(NOISE, **({"place_share": found} | held))

    monkeypatch.setattr(MeasuredWrenches, "_likeliest", likeliest)
    found = 0.247
    with pytest.warns(TtusWarning, match="errors of whole places"):
        assert recorded(24, 8, 2).estimate(1.0)[1].place_share == 0.08
    assert asked == [{}, {"place_share": 0.08}]
    found = 0.23
    assert recorded(24, 8, 2).estimate(1.0)[1].place_share == 0.23


@pytest.mark.slow
def test_what_was_drawn_is_found():
    variance, found = recorded(150, 25, 20).estimate(1.0)
    assert variance == pytest.approx(0.5, rel=0.7)
    for name, value in NOISE.as_dict().items():
        assert found.as_dict()[name] == pytest.approx(value, rel=0.4), name


def test_a_share_at_its_limit_is_not_believed():
    """Then the likelihood takes for errors of places what fields do not know."""
    given, rng = recorded(24, 8, 2), np.random.default_rng(8)
    share = rng.normal(0.0, 0.9, 8)[given.place, None]
    sensor = rng.normal(size=(24, 6)) * ([0.05] * 3 + [2e-3] * 3)
    wild = replace(given, misfit=share * given.wrench + sensor)
    with pytest.warns(TtusWarning, match="errors of whole places.*8 % of the wrench"):
        variance, noise = wild.estimate(1.0)
    usual = PRIORS["place_share"][0]
    assert noise.place_share == usual < MOST_SHARE
    best = wild.log_density(variance, noise)
    for name in ("force", "share", "turn", "torque", "shift"):  # found anew with it
        for factor in (0.5, 2.0):
            other = replace(noise, **{name: factor * getattr(noise, name)})
            lost = np.log(factor) / PRIORS[name][1]
            before = np.log(getattr(noise, name) / PRIORS[name][0]) / PRIORS[name][1]
            prior = 0.5 * ((before + lost) ** 2 - before**2)
            assert wild.log_density(variance, other) - prior < best + 0.3, name


def test_a_sensor_ten_times_worse_than_usual_is_believed_to_be():
    """Priors are weak: what 24 frames show of it moves by a tenth at most."""
    given, sensor = recorded(24, 8, 2), np.repeat([0.5, 0.02], 3)
    errors = sensor * np.random.default_rng(8).normal(size=(24, 6))
    found = replace(given, misfit=errors).estimate(1.0)[1]
    size = np.sqrt((errors**2).reshape(24, 2, 3).mean(axis=(0, 2)))
    assert (found.force, found.torque) == pytest.approx(size, rel=0.1)


def test_frames_are_thinned_evenly_to_the_most(monkeypatch):
    given = recorded(9, 3)
    for most, frames in ((9, range(9)), (8, range(0, 9, 2)), (4, range(0, 9, 3))):
        monkeypatch.setattr(wrench_noise, "MOST_FRAMES", most)
        few = given.thinned()
        np.testing.assert_array_equal(few.misfit, given.misfit[list(frames)])
        np.testing.assert_array_equal(few.images, given.images[:, list(frames)])
        np.testing.assert_array_equal(few.place, given.place[list(frames)])


@pytest.mark.parametrize("fields", [40, 80])  # fewer than measurements, or more
def test_fields_that_frames_do_not_tell_apart_are_left_out(fields):
    given, rng = recorded(9, 12, 3), np.random.default_rng(3)
    alike = rng.normal(size=(fields, len(given.images))) / 6.0
    many = replace(given, images=np.tensordot(alike, given.images, axes=1))
    few = many.condensed(2.0)
    assert len(few.images) == len(given.images) < len(many.images)
    for variance in (0.5, 2.0, 8.0):
        expected = many.log_density(variance, NOISE)
        assert few.log_density(variance, NOISE) == pytest.approx(expected, abs=1e-3)


def weighted():
    """Rows by term, one of them missing, and their dense covariance."""
    given = recorded(6, 2)
    scale = np.array([3.0, 3.0, 3.0, 40.0, 40.0, 40.0])
    at = np.arange(36).reshape(2, 6, 3).transpose(1, 0, 2).reshape(6, 6)
    mixed = np.random.default_rng(3).normal(size=(36, 36))
    mixed[at.reshape(-1)] *= np.tile(scale, 6)[:, None]
    errors = given.errors(0.5, NOISE, sp.csr_array(mixed[:-1]), at)
    whole, order = dense(NOISE, given.wrench, given.place), at.reshape(-1)
    by_row = np.empty((36, 36))
    by_row[np.ix_(order, order)] = whole
    return given, errors, mixed[:-1] @ by_row @ mixed[:-1].T


def test_rows_have_the_products_of_dense_algebra():
    _, errors, covariance = weighted()
    rows = np.random.default_rng(1).normal(size=(4, 35))
    found = rows @ errors.root
    np.testing.assert_allclose(found @ found.T, rows @ covariance @ rows.T, rtol=1e-10)


def test_draws_have_the_covariance():
    _, errors, covariance = weighted()
    rng = np.random.default_rng(2)
    draws = np.stack([errors.draw(rng) for _ in range(4000)])
    size = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    assert np.abs((draws.T @ draws / 4000 - covariance) / size).max() < 0.1


def test_noise_is_read_as_it_was_written():
    forces = WrenchNoise(0.1, 0.02, 0.03, 0.04)
    for noise in (NOISE, replace(NOISE, usual_force=5.0)):
        assert WrenchNoise.from_dict(noise.as_dict()) == noise
    assert list(forces.as_dict()) == ["force", "share", "place_share", "turn"]
    for bad in (-1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="noise must"):
            WrenchNoise.from_dict({**NOISE.as_dict(), "force": bad})
