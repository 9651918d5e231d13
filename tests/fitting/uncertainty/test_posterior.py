"""Draws near the skin: what contact samples, and what is deeper; rows of them."""

import numpy as np
import pytest
import scipy.sparse as sp

from tests.kit import small_scene
from ttus_opt.fitting.uncertainty.posterior import (
    DRAWS_AT_ONCE,
    PosteriorDraws,
    kept_rows,
    skin_voxels,
)


def test_contact_touches_kept_voxels_only_and_all_are_inside():
    scene = small_scene("trilinear")
    kept = skin_voxels(scene.voxmap, 0.012)
    assert np.isin(scene.N.indices, kept).all()
    assert (scene.voxmap.region.reshape(-1)[kept] > 0).all()
    assert len(kept) < len(skin_voxels(scene.voxmap, 0.04))
    assert np.array_equal(kept, np.unique(kept))


def test_deeper_than_the_innermost_layer_is_the_whole_inside():
    voxmap = small_scene("trilinear").voxmap
    inside = np.flatnonzero(voxmap.region.reshape(-1) > 0)
    np.testing.assert_array_equal(skin_voxels(voxmap, 0.5), inside)


@pytest.mark.parametrize("count", [7, 2 * DRAWS_AT_ONCE, 2 * DRAWS_AT_ONCE + 1])
def test_covariance_is_that_of_what_is_measured_of_the_draws(count):
    rng = np.random.default_rng(0)
    values, voxels = rng.normal(size=(count, 3)), np.array([1, 4, 5])
    sizes, sized = rng.normal(size=count), rng.normal(size=6)
    draws = PosteriorDraws(values.astype(np.float32), sizes, voxels, 0.01)
    rows = np.zeros((6, 8))
    rows[0, 1], rows[1, [4, 5]], rows[4, 5], rows[5, 6] = 2.0, (1.0, -3.0), 1.0, 1.0
    found = draws.covariance(sp.csr_array(rows), 2)
    said = rows[:2, voxels] @ values.T
    np.testing.assert_allclose(found[0], said @ said.T / count, rtol=1e-5)
    assert (found[1] == 0.0).all()
    assert np.isnan(found[2]).all()
    said += sized[:2, None] * sizes
    found = draws.covariance(sp.csr_array(rows), 2, sized)
    np.testing.assert_allclose(found[0], said @ said.T / count, rtol=1e-5)


def test_blocks_that_touch_other_voxels_are_told():
    for voxels in (4, 9):  # fewer blocks than voxels, or about as many
        rows = sp.csr_array(np.eye(voxels)[[0, 2, 3, 1, 2, 0]])
        kept, missing = kept_rows(rows, np.array([0, 2]), 2)
        assert missing.tolist() == [False, True, False]
        np.testing.assert_array_equal(kept.toarray()[:2], np.eye(2))
        np.testing.assert_array_equal(kept.toarray()[4:], np.eye(2)[::-1])
