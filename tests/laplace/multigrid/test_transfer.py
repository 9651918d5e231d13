"""Restriction and prolongation, written down as matrices from unit vectors."""

import numpy as np

from tests.laplace.multigrid.conftest import made
from tests.laplace.multigrid.test_solver import box, make_grid
from ttus_opt.core.compiled import compiled
from ttus_opt.laplace.multigrid.hierarchy import Hierarchy
from ttus_opt.laplace.multigrid.kernels import LevelIndex, fill_ghost_rows, level_index
from ttus_opt.laplace.multigrid.transfer import prolong, restrict


@compiled()
def _restricted(table, fields, work):
    restrict(level_index(table[0]), level_index(table[1]), fields, work, (0, 1))


@compiled()
def _prolonged(table, fields, work):
    below = level_index(table[1])
    fill_ghost_rows(below, work, below.x, np.int64(0))
    fill_ghost_rows(below, work, below.x, np.int64(1))
    prolong(level_index(table[0]), below, fields, work, (0, 1))


def matrices(h, free, coarse):
    """R onto free coarse nodes and P onto free black ones, through the kernels."""
    top, below = (LevelIndex(*row.tolist()) for row in h.table[:2])
    fine, small = h.levels[0].layout, h.levels[1].layout
    black = fine.places(np.nonzero(free))
    black = black[black >= fine.colour_size]
    nodes = small.places(np.nonzero(coarse))
    work = np.zeros(h.work_size, np.float32)
    R, P = np.zeros((len(nodes), len(black))), np.zeros((len(black), len(nodes)))
    for n, place in enumerate(black):
        work[:] = 0
        work[top.residual + place - fine.colour_size] = 1
        _restricted(h.table, h.fields, work)
        R[:, n] = work[below.b + nodes]
    for n, place in enumerate(nodes):
        work[:] = 0
        work[below.x + place] = 1
        _prolonged(h.table, h.fields, work)
        P[:, n] = work[top.x + black]
    return R, P


def coarse_free(h):
    """Free nodes of the second level: those with a pivot."""
    level = h.levels[1]
    shape = level.layout.shape
    indices = tuple(np.indices(shape).reshape(3, -1))
    inverse = level.inverse.reshape(-1)[level.layout.places(indices)].reshape(shape)
    free = inverse > 0
    free[:, :, -1] = False  # shares its place where the number of slices is even
    return free


def test_restriction_is_the_transpose():
    """Where an odd circle closes, both leave out what the sweep mends."""
    small = made((10, 12, 8))
    R, P = matrices(small.hierarchy, small.free, coarse_free(small.hierarchy))
    np.testing.assert_allclose(R, P.T, atol=1e-6)
    assert P.any(axis=1).mean() > 0.5


def test_prolongation_keeps_constants_and_never_passes_a_fixed_node():
    grid = make_grid((9, 12, 9))
    free = box(grid)
    free[:, 5] = False  # a wall
    h = Hierarchy.build(grid, free)
    coarse = coarse_free(h)
    _, P = matrices(h, free, coarse)
    total = P.sum(axis=1)
    assert total.max() <= 1.0 + 1e-6 and (total >= 0.0).all()
    layout = h.levels[0].layout
    i, j, k = np.nonzero(free)
    is_black = layout.places((i, j, k)) >= layout.colour_size
    i, j, k = i[is_black], j[is_black], k[is_black]
    far = (i > 2) & (i < 6) & (k > 2) & (k < 6) & ((j > 7) | (j < 3))
    np.testing.assert_allclose(total[far], 1.0, atol=1e-6)
    # of a node next to the wall, one half comes from the wall: from zero
    near = (i > 2) & (i < 6) & (k > 2) & (k < 6) & (j == 6 - j % 2) & (j != 5)
    spoke = np.nonzero(coarse)[1]
    step = grid.shape[1] // h.levels[1].layout.shape[1]
    beyond = spoke * step < 5
    assert not P[np.ix_(near, beyond & (spoke * step > 0))].any()
