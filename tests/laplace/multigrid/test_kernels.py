"""Loops over levels against the operator written down as a matrix."""

import numpy as np

from tests.laplace.multigrid.conftest import noise, split
from ttus_opt.core.compiled import compiled
from ttus_opt.laplace.multigrid import kernels
from ttus_opt.laplace.multigrid.red_black import BLACK, RED
from ttus_opt.laplace.multigrid.workspace import Workspace


@compiled()
def _fill_ghosts(table, work, x, colour):
    at = kernels.level_index(table[0])
    kernels.fill_ghost_rows(at, work, x, colour)
    first, last = kernels.span(at, colour)
    return first, last


def test_the_table_says_where_every_array_lies(small):
    h = small.hierarchy
    for row, level in zip(h.table, h.levels, strict=True):
        index = kernels.LevelIndex(*row.tolist())
        assert (index.n_r, index.n_theta, index.n_z) == level.layout.shape
        for name, array in (("Z", level.Z), ("T", level.T), ("inverse", level.inverse)):
            start = getattr(index, name)
            kept = h.fields[start : start + array.size]
            assert np.shares_memory(kept, array)
            np.testing.assert_array_equal(kept, array.reshape(-1))


def test_closing_the_circle_copies_the_outer_rows(small):
    layout = small.hierarchy.levels[0].layout
    whole = split(layout, noise(small.free))
    work = np.zeros(small.hierarchy.work_size, np.float32)
    at = kernels.LevelIndex(*small.hierarchy.table[0].tolist())
    stored = work[at.x : at.x + whole.size].reshape(whole.shape)
    real = layout.places(np.nonzero(small.free))
    stored.reshape(-1)[real] = whole.reshape(-1)[real]
    for colour in (RED, BLACK):
        first, last = _fill_ghosts(small.hierarchy.table, work, at.x, np.int64(colour))
        places = real[real // layout.colour_size == colour] % layout.width
        assert first <= places.min() and places.max() < last
    np.testing.assert_array_equal(stored[:, 1:-1], whole[:, 1:-1])


def test_flow_is_what_red_nodes_send_to_black_ones(small):
    """On the finest level, whose conductances depend on the layer; with a rest kept."""
    h, layout = small.hierarchy, small.hierarchy.levels[0].layout
    j, k = np.indices(small.grid.shape)[1:]
    black = (((j + 1) * layout.pitch + k) % 2 == BLACK).reshape(-1)
    free, x = small.free.reshape(-1), noise(small.free, 1)
    work = Workspace(h)
    work.x[:] = split(layout, x)
    at = work.index
    before = split(layout, noise(small.free, 2))[BLACK]
    kept = work.values[at.residual : at.residual + before.size]
    kept[:] = before.reshape(-1)
    kernels.flow(h.table[0], h.fields, work.values, at.residual, at.x, -0.5, (0, 1))
    # between neighbours of one colour, where an odd circle closes, nothing is told
    coupling = -small.A * (black[:, None] & ~black[None])
    expected = coupling @ x - 0.5 * noise(small.free, 2)
    places = layout.places(np.nonzero(small.free.reshape(small.grid.shape)))
    own = places[black[free]] - layout.colour_size
    seam = np.isin(j.reshape(-1), (0, small.grid.shape[1] - 1))[free][black[free]]
    inner = ~seam if small.grid.shape[1] % 2 else np.ones_like(seam)
    np.testing.assert_allclose(
        kept[own][inner], expected[free & black][inner], rtol=1e-5, atol=1e-5
    )
