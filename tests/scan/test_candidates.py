"""Candidates of spokes, the usable range of heights, and strays."""

import numpy as np
import pytest

from tests.scan.clouds import cylinder
from ttus_opt.scan.candidates import collect, stray, usable_range


def test_candidates_are_the_points_near_the_spoke():
    """Against brute force over every pair of point and spoke."""
    rng = np.random.default_rng(5)
    points = rng.uniform(-0.2, 0.2, (400, 3))
    theta = np.arange(12) * (2 * np.pi / 12)
    z = np.linspace(-0.1, 0.1, 5)
    found = collect(points, theta, z, spoke_distance=0.02, slice_distance=0.03)
    r = np.hypot(points[:, 0], points[:, 1])
    for j, t in enumerate(theta):
        along = points[:, :2] @ [np.cos(t), np.sin(t)]
        across = points[:, :2] @ [-np.sin(t), np.cos(t)]
        for k, height in enumerate(z):
            near = (np.abs(across) <= 0.02) & (along > 0) & (r > 0.02)
            near &= np.abs(points[:, 2] - height) <= 0.03
            expected = np.sort(r[near])
            assert found.count[j, k] == near.sum()
            kept = found.radius[j, k][np.isfinite(found.radius[j, k])]
            np.testing.assert_allclose(kept, expected)


def test_thinning_keeps_the_distribution():
    r = np.linspace(0.1, 0.2, 1000)
    points = np.stack([r, 0 * r, 0 * r], axis=1)
    z = np.array([0.0, 0.1])
    theta = np.arange(8) * np.pi / 4
    found = collect(points, theta, z, spoke_distance=0.004, slice_distance=0.01)
    kept = found.radius[0, 0]
    assert found.count[0, 0] == 1000 and np.isfinite(kept).all()
    assert kept.mean() == pytest.approx(0.15, abs=0.002)


def test_cut_ends_are_left_out():
    rng = np.random.default_rng(0)
    r = 0.15 * np.sqrt(rng.random(20_000))
    theta = rng.uniform(0, 2 * np.pi, r.size)
    cap = np.stack([r * np.cos(theta), r * np.sin(theta), np.full(r.size, 0.2)], 1)
    found = usable_range(np.concatenate([cylinder(rng, noise=0.001), cap]))
    assert -0.2 <= found[0] < -0.185
    assert 0.185 < found[1] < 0.2


def test_strays_are_dropped_and_surfaces_kept():
    rng = np.random.default_rng(0)
    cloud = cylinder(rng)
    strays = rng.uniform(0.3, 0.6, (30, 3))
    every = np.concatenate([cloud, strays])
    kept = every[~stray(every)]
    assert (np.hypot(kept[:, 0], kept[:, 1]) < 0.2).all()
    assert len(kept) > 0.999 * len(cloud)


@pytest.mark.parametrize("spacing", [0.004, 0.008, 0.012])
def test_a_sparse_front_is_usable_over_its_whole_height(spacing):
    """A camera's view from afar holds less than three points a thin section."""
    x, z = np.meshgrid(np.arange(-0.17, 0.17, spacing), np.arange(0.0, 0.6, spacing))
    y = 0.11 * np.sqrt(np.maximum(1 - (x / 0.17) ** 2, 0.0))
    noise = np.random.default_rng(0).normal(0.0, 0.002, y.shape)
    points = np.stack([x, y + noise, z], axis=-1).reshape(-1, 3)
    found = usable_range(points)
    assert found[0] < 0.06
    assert found[1] > 0.52
