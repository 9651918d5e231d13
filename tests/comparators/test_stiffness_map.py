import numpy as np
import pytest
from scipy.spatial.distance import cdist
from scipy.stats import multivariate_normal

from tests.comparators.contacts import NO_PATCH, STILL, samples
from tests.comparators.contacts import made as on_torso
from ttus_opt.comparators import stiffness_map
from ttus_opt.comparators.patch_model import Contact
from ttus_opt.gaussian.matern import matern
from ttus_opt.gaussian.posterior_mode import PosteriorMode


def palpation(n, noise, seed=0):
    """Depths of 2 to 12 mm on a patch of 8 cm, stiffness from the process itself."""
    rng = np.random.default_rng(seed)
    place = np.column_stack([np.full(n, 0.1), rng.uniform(-0.04, 0.04, (n, 2))])
    cov = 0.35**2 * matern(cdist(place, place), 0.03) + 1e-10 * np.eye(n)
    stiffness = 5.0 * (1.0 + np.linalg.cholesky(cov) @ rng.normal(size=n))
    depth = rng.uniform(0.2, 1.2, n)
    force = stiffness * depth**1.4 + noise * rng.normal(size=n)
    return stiffness_map.Palpation(depth, place, force)


def made(data):
    found = on_torso(stiffness_map.StiffnessMap)
    touching = [
        Contact(h, 0.0, s, STILL, NO_PATCH)
        for h, s in zip(data.depth, data.place, strict=True)
    ]
    found._fit_law(samples(touching, data.force))
    return found


def test_evidence_is_the_density_of_the_forces():
    data, law = palpation(30, 0.1), stiffness_map.PowerLaw(1.2, 0.02, 0.5, 0.2)
    _, stiffness = data.base(1.2)
    mean = stiffness * data.depth**1.2
    C = 0.5**2 * np.outer(mean, mean) * matern(cdist(data.place, data.place), 0.02)
    density = multivariate_normal(mean, C + 0.2**2 * np.eye(30)).logpdf(data.force)
    constant = -0.5 * 30 * np.log(2.0 * np.pi)
    assert data.given(law).log_density + constant == pytest.approx(density)


def test_kriging_is_regression_on_a_dense_field():
    """The same K(s) from a Gaussian field on many places, conditioned as a whole."""
    data = palpation(25, 0.1)
    found = made(data)
    law, mean = found.law, found.mean_stiffness
    asked = np.column_stack([np.full(7, 0.1), np.linspace(-0.05, 0.05, 7), np.zeros(7)])
    every = np.vstack([data.place, asked])
    prior = (mean * law.deviation) ** 2 * matern(cdist(every, every), law.length)
    rows = np.hstack([np.diag(data.depth**law.exponent), np.zeros((25, 7))])
    # information form: no formula of the module is used
    precision = np.linalg.inv(prior + 1e-9 * np.eye(32)) + rows.T @ rows / law.noise**2
    rest = data.force - mean * data.depth**law.exponent
    field = np.linalg.solve(precision, rows.T @ rest / law.noise**2)
    stiffness = mean + field[25:]
    np.testing.assert_allclose(
        [found.stiffness_at(s) for s in asked], stiffness, rtol=1e-5
    )
    half = [Contact(0.5, 0.0, s, STILL, NO_PATCH) for s in asked]
    forces = [found._normal_force(contact) for contact in half]
    np.testing.assert_allclose(forces, stiffness * 0.5**law.exponent, rtol=1e-5)


@pytest.mark.parametrize("steps", [np.zeros(4), *np.eye(4)])
def test_priors_are_wide_about_soft_tissue(steps, monkeypatch):
    """Exponent 1.3, 30 mm, 40 % and 0.15 N, and a deviation from each."""
    monkeypatch.setattr(
        stiffness_map, "posterior_mode", lambda *_: PosteriorMode(steps, 0.0)
    )
    law = stiffness_map.chosen_law(palpation(9, 0.1))
    widths = [0.25, 0.3, 0.5, 1.0]
    expected = np.array([1.3, 0.03, 0.4, 0.15]) * np.exp(widths * steps)
    found = [law.exponent, law.length, law.deviation, law.noise]
    np.testing.assert_allclose(found, expected)


def test_noise_is_never_less_than_a_covariance_needs(monkeypatch):
    silent = PosteriorMode(np.array([0.0, 0.0, 0.0, -30.0]), 0.0)
    monkeypatch.setattr(stiffness_map, "posterior_mode", lambda *_: silent)
    data = palpation(9, 0.1)
    rms = np.sqrt(np.mean(data.force**2))
    assert stiffness_map.chosen_law(data).noise == pytest.approx(1e-4 * rms)


def test_evidence_finds_what_the_data_were_made_with():
    law = stiffness_map.chosen_law(palpation(200, 0.1))
    assert law.exponent == pytest.approx(1.4, abs=0.1)
    assert law.noise == pytest.approx(0.1, rel=0.3)
    assert 0.015 < law.length < 0.06
    assert 0.2 < law.deviation < 0.6
