"""Radial lines solved exactly: pivots and sweeps against dense algebra."""

import numpy as np

from tests.laplace.multigrid.conftest import noise, split
from ttus_opt.laplace.multigrid.coarsening import coarsen, finest
from ttus_opt.laplace.multigrid.line_smoother import inverse_pivots, sweep
from ttus_opt.laplace.multigrid.red_black import BLACK, RED, Layout
from ttus_opt.laplace.multigrid.workspace import Workspace


def test_pivots_are_those_of_an_elimination():
    """One line of five nodes, one of them fixed, links of very different strength."""
    aside = np.zeros((2, 7, 1), np.float32)
    aside[0, :, 0] = [0.0, 2.0, 0.5, 0.0, 1.0, 3.0, 0.0]
    R = np.zeros((2, 7, 1), np.float32)
    R[0, :, 0] = [0.0, 1e6, 0.0, 0.0, 4.0, 0.0, 0.0]
    inverse = inverse_pivots(aside, R)[0, :, 0]
    for own, link in (([2.0, 0.5], 1e6), ([1.0, 3.0], 4.0)):
        first = own[0] + link
        second = own[1] + link - link**2 / first
        start = 1 if link == 1e6 else 4
        np.testing.assert_allclose(
            inverse[start : start + 2], [1 / first, 1 / second], rtol=1e-5
        )
    assert not inverse[[0, 3, 6]].any()


def test_a_sweep_leaves_no_residual_on_its_colour(small):
    layout = small.hierarchy.levels[0].layout
    j, k = np.indices(small.grid.shape)[1:]
    colours = (((j + 1) * layout.pitch + k) % 2).reshape(-1)
    free = small.free.reshape(-1)
    # an odd circle has neighbours of one colour where it closes
    seam = np.isin(j.reshape(-1), (0, small.grid.shape[1] - 1))
    exact = free & ~seam if small.grid.shape[1] % 2 else free
    b = noise(small.free, 1)
    work, places = Workspace(small.hierarchy), layout.places(np.nonzero(small.free))
    work.b[:], work.x[:] = split(layout, b), split(layout, noise(small.free, 2))
    at, h = work.index, small.hierarchy
    size = layout.colour_size
    for colour in (BLACK, RED, BLACK):
        opposite, load = at.x + (1 - colour) * size, at.b + colour * size
        sweep(h.table[0], h.fields, work.values, colour, at.x, opposite, load, (0, 1))
        x = np.zeros(free.size)
        x[free] = work.x.reshape(-1)[places]
        rest = (b - small.A @ x)[exact & (colours == colour)]
        assert np.abs(rest).max() < 1e-5 * np.abs(b).max()


def test_a_sweep_where_every_link_has_its_own_conductance(small):
    """On the second level, against the network's own matrix."""
    h, n = small.hierarchy, 1
    network = finest(small.grid, small.free)
    for axis in np.flatnonzero(h.levels[0].flags):
        network = coarsen(network, int(axis))
    layout = Layout.of(network.shape)
    assert layout == h.levels[1].layout and h.levels[1].T.ndim > 1
    work = np.zeros(h.work_size, np.float32)
    row = h.table[n]
    named = dict(zip(Workspace(h).index._fields, row.tolist(), strict=True))
    size, free = layout.colour_size, network.free
    b, x = noise(free, 3), noise(free, 4)
    work[named["b"] : named["b"] + 2 * size] = split(layout, b).reshape(-1)
    work[named["x"] : named["x"] + 2 * size] = split(layout, x).reshape(-1)
    sweep(row, h.fields, work, BLACK, named["x"], named["x"], named["b"] + size, (0, 1))
    places = layout.places(np.nonzero(free))
    black = places >= size
    x = work[named["x"] + places].astype(float)
    rest = b[free.reshape(-1)] - network.matrix() @ x
    if network.shape[1] % 2:
        j = np.nonzero(free)[1]
        black &= (j > 0) & (j < network.shape[1] - 1)
    assert black.any()
    assert np.abs(rest[black]).max() < 1e-5 * np.abs(b).max()
