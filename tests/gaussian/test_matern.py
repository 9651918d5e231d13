"""Sparse Matérn fields against the covariances they stand for."""

import pickle

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.special import gamma, k1, kv

from tests.kit import small_scene
from ttus_opt.gaussian import matern as matern_module
from ttus_opt.gaussian.matern import (
    MaternFactor,
    SeparableCovariance,
    kronecker,
    matern,
)


def test_matern_32_is_that_of_bessel_functions():
    d, length, nu = np.linspace(0.001, 0.1, 9), 0.03, 1.5
    u = np.sqrt(2.0 * nu) * d / length
    expected = 2.0 ** (1.0 - nu) / gamma(nu) * u**nu * kv(nu, u)
    np.testing.assert_allclose(matern(d, length), expected, rtol=1e-12)


def test_a_line_has_the_matern_32_covariance_to_second_order():
    errors = []
    for n in (101, 201):
        step, length = 0.4 / (n - 1), 0.02
        got = MaternFactor.along_line(n, step, length).covariance(np.array([n // 2]))
        scaled = np.sqrt(3.0) * np.abs(np.arange(n) - n // 2) * step / length
        errors.append(np.abs(got[:, 0] - (1 + scaled) * np.exp(-scaled)).max())
    assert errors[1] < 0.01
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize("share", [0.0, 0.05, 1.0])
def test_the_ends_of_a_line_reflect_its_covariance(share):
    """No flux at the rim: the sum over the mirror images of a node (variance 2 there).

    Of a node at this share of the line's length; to second order.
    """
    reach, length, errors = 0.1, 0.02, []
    for n in (101, 201):
        x = np.linspace(0.0, reach, n)
        node = round(share * (n - 1))
        factor = MaternFactor.along_line(n, x[1], length)
        assert factor.volumes.sum() == pytest.approx(reach)
        expected = sum(
            matern(np.abs(x - sign * x[node] + 2.0 * k * reach), length)
            for sign in (1.0, -1.0)
            for k in range(-2, 3)
        )
        errors.append(
            np.abs(factor.covariance(np.array([node]))[:, 0] - expected).max()
        )
    assert errors[1] < 0.005
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_a_tube_has_the_matern_1_covariance_along_and_around():
    radius, height, length = 0.15, 0.6, 0.06
    errors = []
    for n_theta, n_z in ((60, 41), (120, 81)):
        theta = np.arange(n_theta) * 2 * np.pi / n_theta
        z, middle = np.linspace(0.0, height, n_z), n_z // 2
        T, Z = np.meshgrid(theta, z, indexing="ij")
        points = np.stack([radius * np.cos(T), radius * np.sin(T), Z], axis=-1)
        factor = MaternFactor.on_surface(points, length)
        got = factor.covariance(np.array([middle]))[:, 0].reshape(n_theta, n_z)
        turn = np.minimum(theta, 2 * np.pi - theta)
        kappa = np.sqrt(2.0) / length
        along = kappa * np.maximum(np.abs(z - z[middle]), 1e-12)
        around = kappa * np.maximum(radius * turn, 1e-12)
        errors.append(
            max(
                np.abs(got[0] - along * k1(along)).max(),
                np.abs(got[:, middle] - around * k1(around)).max(),
            )
        )
        area = 2 * np.pi * radius * height
        assert factor.volumes.sum() == pytest.approx(area, rel=2e-3)
    assert errors[1] < 0.025
    # h² log h: the covariance is not smooth at its peak
    assert errors[0] > 2.5 * errors[1]


def test_a_length_around_of_its_own_is_a_tube_of_another_radius():
    theta = np.arange(40) * 2 * np.pi / 40

    def factor(radius, height, ratio):
        T, Z = np.meshgrid(theta, np.linspace(0.0, height, 21), indexing="ij")
        points = np.stack([radius * np.cos(T), radius * np.sin(T), Z], axis=-1)
        return MaternFactor.on_surface(points, 0.05, ratio=ratio)

    stretched, plain = factor(0.2, 0.3, 4.0), factor(0.1, 0.6, 1.0)
    assert stretched.volumes == pytest.approx(plain.volumes)
    assert abs(stretched.rows - plain.rows).max() < 1e-9
    # 100 mm around and 25 mm along correlate alike
    got = stretched.covariance(np.array([10])).reshape(40, 21)[:, 10]
    own = np.sqrt(2.0) * 0.2 * theta[3] / 0.1
    assert got[3] / got[0] == pytest.approx(own * k1(own), abs=0.03)


def test_kronecker_is_that_of_scipy():
    rng = np.random.default_rng(3)
    for shapes in [((5, 4), (7, 9)), ((1, 1), (6, 6)), ((3, 3), (1, 2))]:
        left, right = (
            sp.random_array(shape, density=0.5, rng=rng, format="csr")
            for shape in shapes
        )
        left.data[: left.indptr[1]] = 0.0
        left.eliminate_zeros()  # a row without entries
        found = kronecker(left, right)
        np.testing.assert_array_equal(
            found.toarray(), np.kron(left.toarray(), right.toarray())
        )
        assert found.nnz == left.nnz * right.nnz
        assert found.has_canonical_format


def test_columns_solved_for_in_several_goes_are_those_of_one(monkeypatch):
    factor = MaternFactor.along_line(20, 0.004, 0.02)
    white = np.random.default_rng(0).normal(size=(20, 7))
    times, drawn = factor.covariance_times(white), factor.draw(white)
    np.testing.assert_allclose(factor.rows @ drawn, white, atol=1e-9)
    for entries in (5, 60):  # one at a time, and three
        monkeypatch.setattr(matern_module, "ENTRIES", entries)
        np.testing.assert_allclose(factor.covariance_times(white), times, rtol=1e-12)
        np.testing.assert_allclose(factor.draw(white), drawn, rtol=1e-12)


@pytest.mark.parametrize("entries", [1, 460_800])
def test_rows_columns_and_products_agree_with_dense_algebra(entries, monkeypatch):
    monkeypatch.setattr(matern_module, "ENTRIES", entries)
    voxmap = small_scene("voxel-mean", (7, 12, 8), 2).voxmap
    V = voxmap.grid.n_voxels
    scale = np.random.default_rng(0).uniform(0.5, 2.0, V)
    covariance = SeparableCovariance.over(voxmap, scale, 0.05, 0.02)
    dense = np.linalg.inv((covariance.rows.T @ covariance.rows).toarray())
    voxels = np.array([3, 200, 201, 577, V - 1])
    columns = covariance.columns(voxels)
    some = np.arange(5.0) - 1.7
    few = sp.csr_array(
        sp.random_array((3, V), density=0.05, rng=np.random.default_rng(2))
    )
    np.testing.assert_allclose(columns.of_rows(few), few @ dense[:, voxels], rtol=1e-7)
    size = np.abs(dense).max()
    among = dense[np.ix_(voxels, voxels)]
    assert np.abs(columns.among - among).max() < 1e-9 * size
    assert np.abs(columns.among_some([3, 1]) - among[:, [3, 1]]).max() < 1e-9 * size
    assert np.abs(columns.variance - np.diag(among)).max() < 1e-9 * size
    assert np.abs(columns.among_times(some) - among @ some).max() < 1e-8 * size
    assert np.abs(columns.times(some) - dense[:, voxels] @ some).max() < 1e-8 * size
    every = np.cos(np.arange(V))
    assert np.abs(covariance.times(every) - dense @ every).max() < 1e-7 * size


def test_blocks_of_rows_agree_with_dense_algebra(monkeypatch):
    """Also where the surface's part is solved for in several goes."""
    monkeypatch.setattr(matern_module, "AT_ONCE", 7)
    voxmap = small_scene("voxel-mean", (7, 12, 8), 2).voxmap
    V, rng = voxmap.grid.n_voxels, np.random.default_rng(1)
    covariance = SeparableCovariance.over(voxmap, rng.uniform(0.5, 2.0, V), 0.05, 0.02)
    rows = sp.csr_array(sp.random_array((12, V), density=0.02, rng=rng))
    whole = np.stack([covariance.times(row) for row in rows.toarray()]) @ rows.T
    blocks = [whole[i : i + 3, i : i + 3] for i in range(0, 12, 3)]
    np.testing.assert_allclose(covariance.among_rows(rows, 3), blocks, rtol=1e-8)


def test_the_rows_make_white_noise_of_a_drawn_field():
    voxmap = small_scene("voxel-mean", (7, 12, 8), 2).voxmap
    scale = np.random.default_rng(0).uniform(0.5, 2.0, voxmap.grid.n_voxels)
    covariance = SeparableCovariance.over(voxmap, scale, 0.05, 0.02)
    drawn = covariance.draw(np.random.default_rng(3))
    white = np.random.default_rng(3).standard_normal(len(drawn))
    np.testing.assert_allclose(covariance.rows @ drawn, white, atol=1e-9)


def test_a_covariance_in_use_can_be_pickled():
    """With it a depth map's solution: what `fit` gives by default."""
    voxmap = small_scene("voxel-mean", (7, 12, 8), 2).voxmap
    given = SeparableCovariance.over(voxmap, np.ones(672), 0.05, 0.02)
    one = np.eye(1, 672, 100)[0]
    expected = given.times(one)
    again = pickle.loads(pickle.dumps(given))
    np.testing.assert_array_equal(again.times(one), expected)


def uneven_tube():
    """Nodes around and along an ellipse's tube, at uneven steps of both."""
    rng = np.random.default_rng(5)
    theta = np.sort(rng.uniform(0.0, 2.0 * np.pi, 14))[:, None]
    z = np.sort(rng.uniform(0.0, 0.3, 9))
    x, y = 0.12 * np.cos(theta) + 0.0 * z, 0.09 * np.sin(theta) + 0.0 * z
    return np.stack([x, y, np.broadcast_to(z, x.shape)], axis=-1)


def test_a_tube_is_the_same_from_either_side_and_end():
    points = uneven_tube()
    whole = MaternFactor.on_surface(points, 0.05, ratio=2.0).operator.toarray()
    for flip in (np.s_[::-1], np.s_[:, ::-1]):
        order = np.arange(points[..., 0].size).reshape(points.shape[:2])[flip].ravel()
        turned = MaternFactor.on_surface(points[flip], 0.05, ratio=2.0).operator
        np.testing.assert_allclose(turned.toarray(), whole[np.ix_(order, order)])


def test_an_open_tube_stands_apart_from_its_wall():
    points = uneven_tube()
    n_theta, n_z, _ = points.shape
    factor = MaternFactor.on_surface(points, 0.05, is_open=True)
    field = factor.covariance(np.arange(n_z)).reshape(n_theta, n_z, n_z)
    assert not field[-1].any()  # of the first line, none at the wall
    links = factor.stiffness.toarray().reshape(n_theta, n_z, n_theta, n_z)
    assert not links[0, :, -2].any() and not links[-1, :, -2].any()
    assert links[0, :, 1].any() and links[-3, :, -2].any()
    # the wall is as far from the first line as the second is
    around, along = points[1, 0] - points[0, 0], points[0, 1] - points[0, 0]
    area = np.linalg.norm(around) * np.linalg.norm(along) / 2.0
    assert factor.volumes[0] == pytest.approx(area)
