"""The scene on fewer voxels."""

import numpy as np
import pytest

from tests.kit import dragged_scene, small_scene
from ttus_opt.contact.scene import Scene
from ttus_opt.fitting.weights import coarse_scene
from ttus_opt.fitting.weights.coarse_scene import coarse_shape, coarser


def test_a_coarse_scene_keeps_shape_and_boundary(monkeypatch):
    scene = small_scene("trilinear", shape=(12, 24, 16), n_poses=4)
    assert coarser(scene) is scene
    most = scene.n_voxels // 4
    monkeypatch.setattr(coarse_scene, "MOST_VOXELS", most)
    coarse = coarser(scene)
    assert 0.6 * most < coarse.n_voxels < 1.6 * most
    whole, own = scene.voxmap.grid, coarse.voxmap.grid
    shares = np.divide(own.shape, whole.shape)
    np.testing.assert_allclose(shares, shares.mean(), rtol=0.25)
    assert (own.r_inner, own.r_outer) == (whole.r_inner, whole.r_outer)
    assert (coarse.inner, coarse.outer) == (scene.inner, scene.outer)
    assert coarse.sampling == scene.sampling
    assert coarse.trajectory is scene.trajectory


def test_a_boundary_that_was_fitted_is_fitted_again(monkeypatch):
    given = dragged_scene("contact", mu=0.0)
    scene = Scene.assemble(
        given.voxmap,
        given.shell,
        given.trajectory,
        inner="fit",
        outer=0.7,
        sampling="trilinear",
    )
    monkeypatch.setattr(coarse_scene, "MOST_VOXELS", scene.n_voxels // 4)
    coarse = coarser(scene)
    assert coarse.inner == coarse.parameters["boundary_scale"] != scene.inner
    assert coarse.outer / coarse.inner == pytest.approx(0.7)


def test_a_coarse_shape_has_about_as_many_voxels_as_asked():
    shape = coarse_shape((96, 240, 120), 60_000)
    assert np.prod(shape) == pytest.approx(60_000, rel=0.2)
    assert coarse_shape((24, 72, 30), 60_000) == (24, 72, 30)
