"""Laws of every prior: products, rows, draws and columns are of one covariance."""

import functools

import numpy as np
import pytest
import scipy.sparse as sp

from tests.kit import small_scene
from ttus_opt.gaussian.matern import SeparableCovariance
from ttus_opt.gaussian.prior import LaplacePrior

SCENE = small_scene("trilinear", shape=(5, 8, 6), n_poses=4)
V = SCENE.n_voxels


def matern():
    scale = np.random.default_rng(4).uniform(0.5, 2.0, V)
    return SeparableCovariance.over(SCENE.voxmap, scale, 0.06, 0.02)


def laplace():
    compliance = np.where(SCENE.laplace.free, 0.5, 0.0)  # hard boundary values
    return LaplacePrior(SCENE.laplace, compliance)


PRIORS = {"laplace": laplace, "matern": matern}
every = pytest.mark.parametrize("name", PRIORS)


@functools.cache
def prior_of(name):
    return PRIORS[name]()


@functools.cache
def dense(name):
    """C from matrices, not from the prior's products."""
    if name == "laplace":
        inverse = np.linalg.inv(SCENE.L.toarray())
        return np.asarray(inverse * laplace().compliance @ inverse.T)
    R = matern().rows.toarray()
    return np.linalg.inv(R.T @ R)


def close(found, expected):
    size = np.abs(expected).max()
    np.testing.assert_allclose(found / size, expected / size, atol=1e-8)


def some_rows():
    """Three blocks of two rows, one of them empty."""
    rng = np.random.default_rng(5)
    rows = rng.normal(size=(6, V)) * (rng.uniform(size=(6, V)) < 0.1)
    rows[2:4] = 0.0
    return sp.csr_array(rows)


@every
def test_products_are_those_of_the_covariance(name):
    values = np.random.default_rng(6).normal(size=V)
    expected = dense(name) @ values
    close(prior_of(name).times(values), expected)
    assert prior_of(name).square(values) == pytest.approx(values @ expected, rel=1e-8)
    rough = prior_of(name).within(1e-3).times(values)
    assert np.linalg.norm(rough - expected) < 0.02 * np.linalg.norm(expected)


def test_solves_are_as_accurate_as_asked():
    values = np.random.default_rng(6).normal(size=V)
    rough, fine = (
        np.linalg.norm(laplace().within(rtol).times(values) - dense("laplace") @ values)
        for rtol in (1e-6, 1e-10)
    )
    assert rough > 1e3 * fine


@every
@pytest.mark.parametrize("height", [1, 2, 6])
def test_rows_have_its_covariance(name, height):
    rows, found = some_rows(), prior_of(name).among_rows(some_rows(), height)
    expected = rows @ dense(name) @ rows.T
    assert found.shape == (6 // height, height, height)
    for k, block in enumerate(found):
        own = slice(k * height, (k + 1) * height)
        np.testing.assert_allclose(
            block, expected[own, own], atol=1e-8 * np.abs(expected).max()
        )


@every
def test_draws_have_its_covariance(name):
    """Of 2,000 draws a standard deviation is off by 1/√4000."""
    rng, rows = np.random.default_rng(7), some_rows().toarray()[[0, 1, 4, 5]]
    seen = rows @ np.stack([prior_of(name).draw(rng) for _ in range(2000)], axis=1)
    expected = rows @ dense(name) @ rows.T
    found, size = seen @ seen.T / 2000, np.sqrt(np.diag(expected))
    assert np.abs((found - expected) / np.outer(size, size)).max() < 0.1


def test_columns_are_those_of_the_covariance():
    C, voxels = dense("matern"), np.array([3, 17, 18, 90, V - 1])
    columns, values = prior_of("matern").columns(voxels), np.arange(5.0)
    close(columns.among, C[np.ix_(voxels, voxels)])
    close(columns.times(values), C[:, voxels] @ values)
    close(columns.of_rows(some_rows()), some_rows() @ C[:, voxels])
