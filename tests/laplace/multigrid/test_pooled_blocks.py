"""Pooled blocks against P written down as a matrix."""

import numpy as np
import pytest

from tests.laplace.multigrid.conftest import split
from tests.laplace.multigrid.test_pooled import some_pooled, spread
from tests.laplace.multigrid.test_solver import box, make_grid
from ttus_opt.laplace.multigrid.pooled_blocks import PooledBlocks, block_heads, pool
from ttus_opt.laplace.multigrid.red_black import Layout

GRID = make_grid((9, 6, 6))
FREE = box(GRID)


def test_heads_by_hand():
    pooled = np.array([0, 1, 1, 0, 0, 1, 0], dtype=bool)  # one spoke
    np.testing.assert_array_equal(block_heads(pooled, 1), [0, 1, 1, 1, 4, 5, 5])


@pytest.mark.parametrize("seed", range(3))
def test_prolong_and_restrict_are_P_and_its_transpose(seed):
    rng = np.random.default_rng(seed)
    pooled = some_pooled(FREE, seed, 0.5)
    P, member = spread(FREE, pooled, rng)
    leads = np.zeros(FREE.size, dtype=bool)
    leads[member] = True
    blocks = PooledBlocks.of(
        FREE.reshape(-1), pooled.reshape(-1), leads, GRID.strides[0]
    )
    z = rng.normal(size=len(member))
    full = np.zeros(FREE.size)
    full[member] = z
    blocks.prolong(full)
    np.testing.assert_array_equal(full[FREE.reshape(-1)], P @ z)
    load = np.where(FREE.reshape(-1), rng.normal(size=FREE.size), 0.0)
    expected = P.T @ load[FREE.reshape(-1)]
    stored = split(Layout.of(GRID.shape), load)
    blocks.restrict(load)
    np.testing.assert_allclose(load[member], expected, atol=1e-14)
    assert not load[~leads].any()
    assert blocks.longest == int(np.asarray(P.sum(axis=0)).max())
    # the same on vectors in red-black order
    work = np.concatenate([np.zeros(5, np.float32), stored.reshape(-1)])
    pool(work, *blocks.places(Layout.of(GRID.shape), 5))
    expected_stored = split(Layout.of(GRID.shape), load).reshape(-1)
    real = Layout.of(GRID.shape).places(np.nonzero(FREE))
    np.testing.assert_allclose(work[5:][real], expected_stored[real], atol=1e-5)


def test_no_block_is_one_voxel_long():
    nothing = np.zeros(FREE.size, dtype=bool)
    flat = FREE.reshape(-1)
    blocks = PooledBlocks.of(flat, nothing, flat, GRID.strides[0])
    assert blocks.longest == 1 and not len(blocks.followers)
