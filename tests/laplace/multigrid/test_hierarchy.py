"""Levels packed for compiled code: what they hold, and the coarsest one's inverse."""

import numpy as np

from tests.laplace.multigrid.test_pooled import some_pooled
from ttus_opt.laplace.multigrid import coarsening
from ttus_opt.laplace.multigrid.hierarchy import Hierarchy
from ttus_opt.laplace.multigrid.workspace import Workspace
from ttus_opt.voxmap.grid import CylindricalGrid


def test_levels_are_the_coarsened_networks(small):
    network = coarsening.finest(small.grid, small.free)
    for level in small.hierarchy.levels:
        assert level.layout.shape == network.shape
        if level.T.ndim > 1:
            np.testing.assert_array_equal(level.Z, level.layout.split(network.links[2]))
            for axis in range(3):
                before, after = network.weights(axis)
                np.testing.assert_array_equal(
                    level.weights[2 * axis], level.layout.split(before)
                )
                np.testing.assert_array_equal(
                    level.weights[2 * axis + 1], level.layout.split(after)
                )
        for axis in np.flatnonzero(level.flags):
            network = coarsening.coarsen(network, int(axis))
    assert network.n_free <= coarsening.DIRECT_NODES
    inverse = small.hierarchy.inverse.astype(float)
    np.testing.assert_allclose(
        inverse @ network.matrix(), np.eye(network.n_free), atol=1e-4
    )


def test_pooled_blocks_are_stiff_links_of_the_finest_level(small):
    pooled = some_pooled(small.free, 0)
    plain, tied = small.hierarchy, Hierarchy.build(small.grid, small.free, pooled)
    layout = plain.levels[0].layout
    inside = pooled & (np.arange(small.grid.shape[2]) < layout.pitch)
    places = layout.places(np.nonzero(inside))
    i = np.nonzero(inside)[0]
    np.testing.assert_allclose(
        tied.levels[0].R.reshape(-1)[places],
        plain.levels[0].R[i] * np.float32(coarsening.STIFFNESS),
    )
    assert plain.levels[0].R.ndim == 1 and tied.levels[0].T.ndim == 1


def test_more_vectors_take_their_size(small):
    h = small.hierarchy
    more = Workspace(h, more=2).values.nbytes - Workspace(h).values.nbytes
    assert more == 2 * 4 * h.levels[0].layout.colour_size


def test_levels_are_parts_of_one_array():
    grid = CylindricalGrid(0.03, 0.18, 0.0, 0.3, (17, 32, 16))
    free = np.zeros(grid.shape, dtype=bool)
    free[1:-1, :, 1:-1] = True
    hierarchy = Hierarchy.build(grid, free)
    assert len(hierarchy.levels) > 2
    for level in hierarchy.levels:
        for array in level.arrays:
            assert np.shares_memory(array, hierarchy.fields)
