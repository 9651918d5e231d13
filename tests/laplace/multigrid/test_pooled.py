"""The multigrid of pooled voxels against a factorisation of PᵀA P."""

import pickle

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from tests.laplace.multigrid.test_solver import (
    box,
    explicit,
    make_grid,
    neck,
    pockets,
    torso,
)
from ttus_opt.core.errors import NumericalError
from ttus_opt.laplace.multigrid import Multigrid, PooledBlocks
from ttus_opt.laplace.multigrid import solver as solver_module

GRIDS = {
    "even": make_grid((16, 24, 14)),
    "odd": make_grid((15, 25, 13)),
    "thin slices": make_grid((20, 9, 3)),
    "few spokes": make_grid((18, 4, 7)),
    "tall": make_grid((14, 16, 20), z_max=1.5),
}


def allowed(free):
    """Voxels that may be pooled: both they and the next one outwards are free."""
    both = np.zeros_like(free)
    both[:-1] = free[:-1] & free[1:]
    return both


def some_pooled(free, seed, share=0.3):
    return allowed(free) & (np.random.default_rng(seed).random(free.shape) < share)


def whole_spokes(free, seed):
    """Every second or third spoke is one block, inside to outside."""
    rng = np.random.default_rng(seed)
    return allowed(free) & (rng.random(free.shape[1:]) < 0.4)[None]


def every_spoke(free, seed):
    del seed
    return allowed(free)


def nearly_whole(free, seed):
    """Blocks over nearly the whole radius, cut at a random layer each."""
    rng = np.random.default_rng(seed)
    pooled = allowed(free)
    cut = rng.integers(1, free.shape[0] - 1, free.shape[1:])
    np.put_along_axis(pooled, cut[None], False, axis=0)
    return pooled


def one_pair(free, seed):
    pooled = np.zeros_like(free)
    spots = np.argwhere(allowed(free))
    pooled[tuple(spots[seed % len(spots)])] = True
    return pooled


def spread(free, pooled, rng):
    """P by connected components, on free voxels, and a random member of each block."""
    stride = free.shape[1] * free.shape[2]
    number = np.full(free.size, -1)
    number[free.reshape(-1)] = np.arange(free.sum())
    joined = np.flatnonzero(pooled)
    n = int(free.sum())
    links = sp.coo_array(
        (np.ones(len(joined)), (number[joined], number[joined + stride])), shape=(n, n)
    )
    count, label = connected_components(links, directed=False)
    P = sp.csc_array((np.ones(n), (np.arange(n), label)), shape=(n, count))
    order = rng.permutation(n)
    member = np.empty(count, dtype=np.int64)
    member[label[order]] = np.flatnonzero(free)[order]
    return P, member


def aggregated(grid, free, pooled, seed=0):
    """The solver, and the voxels at which blocks stand."""
    _, member = spread(free, pooled, np.random.default_rng(seed))
    shown = np.zeros(free.size, dtype=bool)
    shown[member] = True
    blocks = PooledBlocks.of(
        free.reshape(-1), pooled.reshape(-1), shown, grid.strides[0]
    )
    return Multigrid(grid, free, blocks=blocks), shown


def product(solver, z):
    """PᵀA P z as residuals are computed."""
    x = z.copy()
    solver.blocks.prolong(x)
    out = solver._product(x)
    solver.blocks.restrict(out)
    return out


def check(grid, free, pooled, seed=0):
    """Solution, residual and zeros, for a right-hand side that is noise."""
    rng = np.random.default_rng(seed)
    P, member = spread(free, pooled, rng)
    K = sp.csc_array(P.T @ explicit(grid, free) @ P)
    solver, shown = aggregated(grid, free, pooled, seed)
    b = np.where(shown, rng.standard_normal(free.size), 0.0)
    np.testing.assert_allclose(
        product(solver, b)[member], K @ b[member], atol=1e-12 * abs(K).max()
    )
    result = solver.solve(b)
    assert not result.x[~shown].any()
    expected = splu(K).solve(b[member])
    error = np.linalg.norm(result.x[member] - expected)
    assert error <= 1e-9 * np.linalg.norm(expected)
    residual = b[member] - K @ result.x[member]
    assert np.linalg.norm(residual) <= 2e-12 * np.linalg.norm(b)


@pytest.mark.parametrize("name", GRIDS)
@pytest.mark.parametrize(
    "pooled", [some_pooled, whole_spokes, every_spoke, nearly_whole, one_pair]
)
def test_equals_a_factorisation(pooled, name):
    grid = GRIDS[name]
    free = box(grid)
    check(grid, free, pooled(free, 3))


@pytest.mark.parametrize("mask", [torso, pockets, neck])
@pytest.mark.parametrize("pooled", [some_pooled, whole_spokes, every_spoke])
def test_equals_a_factorisation_on_ill_shaped_masks(mask, pooled):
    for name in ("even", "odd"):
        free = mask(GRIDS[name])
        check(GRIDS[name], free, pooled(free, 4))


def test_a_block_through_a_neck_of_one_voxel():
    """Two chambers that meet in a block which is the neck itself."""
    grid = make_grid((15, 12, 9))
    free = box(grid)
    free[6:9] = False
    free[6:9, 5, 4] = True
    pooled = np.zeros_like(free)
    pooled[3:11, 5, 4] = True
    check(grid, free, pooled)


@settings(max_examples=25)
@given(
    shape=st.tuples(st.integers(4, 14), st.integers(4, 13), st.integers(3, 10)),
    fixed=st.floats(0.0, 0.9),
    joined=st.floats(0.0, 1.0),
    height=st.floats(0.02, 3.0),
    seed=st.integers(0, 1000),
)
def test_equals_a_factorisation_on_any_mask_and_ties(
    shape, fixed, joined, height, seed
):
    grid = make_grid(shape, z_max=height)
    free = box(grid) & (np.random.default_rng(seed).random(shape) >= fixed)
    if free.any():
        check(grid, free, some_pooled(free, seed + 1, joined), seed)


def test_sizes_do_not_matter():
    grid = GRIDS["odd"]
    free = torso(grid)
    solver, shown = aggregated(grid, free, some_pooled(free, 1))
    b = np.where(shown, np.random.default_rng(1).standard_normal(free.size), 0.0)
    x = solver.solve(b).x
    for size in (1e-200, 1e200):
        np.testing.assert_allclose(solver.solve(size * b).x / size, x, rtol=1e-9)
    assert not solver.solve(np.zeros(free.size)).x.any()


def test_what_stands_elsewhere_is_left_out():
    grid = GRIDS["even"]
    free = box(grid)
    pooled = some_pooled(free, 2)
    solver, shown = aggregated(grid, free, pooled)
    b = np.random.default_rng(3).standard_normal(free.size)
    kept = solver.solve(np.where(shown, b, 0.0)).x
    np.testing.assert_array_equal(solver.solve(b).x, kept)


def test_a_residual_out_of_reach_is_an_error(monkeypatch):
    grid = GRIDS["even"]
    free = box(grid)
    pooled = every_spoke(free, 0)
    solver, shown = aggregated(grid, free, pooled)
    b = np.where(shown, 1.0 + np.arange(free.size), 0.0)
    with pytest.raises(NumericalError, match=r"residual of .* after 1 cycles"):
        monkeypatch.setattr(solver_module, "MOST_CYCLES", 1)
        solver.solve(b)
    monkeypatch.undo()
    assert solver.solve(b, rtol=0.0).relative_residual <= 1e-13  # down to rounding


def test_pickles():
    grid = GRIDS["even"]
    free = torso(grid)
    pooled = some_pooled(free, 1)
    solver, shown = aggregated(grid, free, pooled)
    b = np.where(shown, np.random.default_rng(3).standard_normal(free.size), 0.0)
    copy = pickle.loads(pickle.dumps(solver))
    np.testing.assert_array_equal(copy.solve(b).x, solver.solve(b).x)


def test_blocks_cost_hardly_more_cycles_than_none():
    grid = make_grid((24, 48, 24))
    free = torso(grid)
    b = np.where(
        free.reshape(-1), np.random.default_rng(3).standard_normal(free.size), 0
    )
    plain = Multigrid(grid, free).solve(b).iterations
    for pooled in (some_pooled, nearly_whole):
        solver, _ = aggregated(grid, free, pooled(free, 1))
        assert solver.solve(b).iterations <= 1.5 * plain
