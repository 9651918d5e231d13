"""Sparse Matérn fields against the covariances they stand for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import k1

from tests.conftest import small_scene
from ttus_opt.terms.matern import MaternFactor, SeparableCovariance


def test_a_line_has_the_matern_32_covariance_to_second_order() -> None:
    errors = []
    for n in (101, 201):
        step, length = 0.4 / (n - 1), 0.02
        got = MaternFactor.along_line(n, step, length).covariance(np.array([n // 2]))
        scaled = np.sqrt(3.0) * np.abs(np.arange(n) - n // 2) * step / length
        errors.append(np.abs(got[:, 0] - (1 + scaled) * np.exp(-scaled)).max())
    assert errors[1] < 0.01
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_a_tube_has_the_matern_1_covariance_along_and_around() -> None:
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


def test_a_length_around_of_its_own_is_a_tube_of_another_radius() -> None:
    theta = np.arange(40) * 2 * np.pi / 40

    def factor(radius: float, height: float, ratio: float) -> MaternFactor:
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


def test_rows_columns_and_products_agree_with_dense_algebra() -> None:
    voxmap = small_scene("voxel-mean", (7, 12, 8), 2).voxmap
    V = voxmap.grid.n_voxels
    scale = np.random.default_rng(0).uniform(0.5, 2.0, V)
    covariance = SeparableCovariance.over(voxmap, scale, 0.05, 0.02)
    dense = np.linalg.inv((covariance.rows.T @ covariance.rows).toarray())
    voxels = np.array([3, 200, 201, 577, V - 1])
    columns = covariance.columns(voxels)
    some = np.arange(5.0) - 1.7
    size = np.abs(dense).max()
    assert np.abs(columns.among - dense[np.ix_(voxels, voxels)]).max() < 1e-9 * size
    assert np.abs(columns.times(some) - dense[:, voxels] @ some).max() < 1e-8 * size
    every = np.cos(np.arange(V))
    assert np.abs(covariance.times(every) - dense @ every).max() < 1e-7 * size
