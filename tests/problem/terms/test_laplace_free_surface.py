"""The skin is dropped from the rows, and pushes."""

import numpy as np

from tests.conftest import small_scene
from ttus_opt.fitting.batch import fit
from ttus_opt.problem.terms.laplace_free_surface import (
    LaplaceFreeSurfaceTerm,
    free_surface_layer,
)

SCENE = small_scene("trilinear")


def test_free_surface_drops_the_skin_and_nothing_else():
    rows = LaplaceFreeSurfaceTerm(SCENE, skin=0.25).rows().blocks["p"]
    skin = free_surface_layer(SCENE.voxmap.on_surface).reshape(-1)
    assert skin.any()
    assert not skin.reshape(SCENE.voxmap.grid.shape)[:, :, 0].any()
    assert abs(rows[~skin] - SCENE.L[~skin]).max() == 0.0
    np.testing.assert_allclose(rows[skin].data, 0.5)
    dropped = LaplaceFreeSurfaceTerm(SCENE, skin=0.0).rows().blocks["p"]
    assert dropped[skin].nnz == 0


def test_free_surface_lets_the_skin_push():
    """Measured forces raise the skin under the probe, and leave it elsewhere."""
    solution = fit(SCENE, "free_surface", force_weight=1.0, torque_weight=0.0)
    p = solution.field.values
    skin = free_surface_layer(SCENE.voxmap.on_surface)
    # points near the skin sample the layer below it: their spokes are what counts
    touched = (np.abs(SCENE.N).sum(axis=0) > 0).reshape(p.shape).any(axis=0)
    assert p[skin & touched].max() > 0.1
    assert p[SCENE.voxmap.region >= 0].min() >= -1e-6
    fixed = fit(SCENE, "eq10", force_weight=1.0, torque_weight=0.0)
    assert solution.costs["force"] < fixed.costs["force"]
    far = skin & (np.arange(p.shape[1]) * 2 * np.pi / p.shape[1] > np.pi + 0.6)[:, None]
    assert np.abs(p[far]).max() < 0.05 * p[skin].max()
