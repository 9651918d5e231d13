"""The plain assembly is the compiled one, written differently."""

import numpy as np
import pytest

from tests.kit import small_scene
from tests.oracles.plain_assembly import plain_laplace, plain_rows


@pytest.mark.parametrize("shape", [(9, 20, 10), (8, 15, 7)], ids=["even", "odd"])
def test_laplace_is_the_same(shape):
    scene = small_scene(shape=shape)
    L, b = plain_laplace(scene.voxmap, scene.inner, scene.outer)
    assert abs(L - scene.L).max() < 1e-12 * abs(scene.L).max()
    np.testing.assert_allclose(b, scene.b, atol=1e-11)


@pytest.mark.parametrize("sampling", ["voxel-mean", "trilinear"])
def test_rows_are_the_same(sampling):
    scene = small_scene(sampling)
    poses = scene.trajectory
    N, W = plain_rows(
        scene.voxmap, scene.shell, poses.rotation, poses.position, sampling
    )
    assert scene.N.nnz > 0
    assert abs(N - scene.N).max() < 1e-12 * abs(scene.N).max()
    assert abs(W - scene.W).max() < 1e-12 * abs(scene.W).max()
