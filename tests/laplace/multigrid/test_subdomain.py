"""Boxes of the grid for approximate solves, against the same boxes written as masks."""

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator, cg, splu

from tests.laplace.multigrid.test_solver import explicit, make_grid, torso
from ttus_opt.laplace.multigrid import Multigrid, PooledBlocks
from ttus_opt.laplace.multigrid.subdomain import LARGE, MARGIN, SPOKES, Subdomain

GRID = make_grid((24, 64, 40))


def patch(grid, free, spoke):
    """Free voxels within three layers under the skin of a few spokes and slices."""
    spokes = (spoke + np.arange(-3, 4)) % grid.shape[1]
    chosen = np.zeros(grid.shape, dtype=bool)
    for j in spokes:
        for k in range(16, 25):
            # the first stretch of free voxels from the inside ends under the skin
            skin = int(np.argmin(free[1:, j, k])) + 1
            chosen[skin - 3 : skin, j, k] = True
    return np.flatnonzero(chosen & free)


def run(cycle, at, b):
    """One V-cycle on values at some voxels."""
    places = cycle.places(at)
    cycle.b.fill(0.0)
    cycle.b[places] = b
    cycle.run()
    return cycle.x[places].astype(float)


@pytest.mark.parametrize("spoke", [30, 0, 62])
def test_holds_the_voxels_and_their_margin(spoke):
    """Also where the box passes θ = 0."""
    free = torso(GRID)
    near = patch(GRID, free, spoke)
    box = Subdomain.around(GRID, near)
    inside = GRID.unflatten(box.extend(np.ones(box.shape, dtype=bool)))
    assert inside.sum() == np.prod(box.shape) < LARGE * GRID.n_voxels
    assert box.shape[1] % SPOKES == 0
    i, j, k = np.unravel_index(near, GRID.shape)
    for a in (-MARGIN, 0, MARGIN):
        assert inside[(i + a).clip(0, GRID.shape[0] - 1), j, k].all()
        assert inside[i, (j + a) % GRID.shape[1], k].all()
        assert inside[i, j, (k + a).clip(0, GRID.shape[2] - 1)].all()


@pytest.mark.parametrize(("n_theta", "n_z"), [(34, 60), (50, 34)])
def test_the_margin_of_a_wide_patch_is_half_of_its_smaller_width(n_theta, n_z):
    grid = make_grid((110, 240, 160))
    layer, spoke, slices = 60, 10, 40
    at = np.ix_([layer], spoke + np.arange(n_theta), slices + np.arange(n_z))
    chosen = np.zeros(grid.shape, dtype=bool)
    chosen[at] = True
    box = Subdomain.around(grid, np.flatnonzero(chosen))
    arc = grid.theta_step * grid.r[layer]  # [m]
    reach = 0.5 * min(n_theta * arc, n_z * grid.z_step)
    margins = [int(np.ceil(reach / step)) for step in (grid.r_step, arc, grid.z_step)]
    assert min(margins) > MARGIN
    assert box.first == tuple(np.subtract((layer, spoke, slices), margins) % grid.shape)
    assert box.shape[::2] == (1 + 2 * margins[0], n_z + 2 * margins[2])
    assert 0 < box.shape[1] - n_theta - 2 * margins[1] <= SPOKES


@pytest.mark.parametrize("spoke", [30, 0])
def test_its_arrays_are_the_grids(spoke):
    free = torso(GRID)
    box = Subdomain.around(GRID, patch(GRID, free, spoke))
    values = np.arange(GRID.n_voxels, dtype=float)
    known = box.extend(box.free(free))
    at = np.flatnonzero(known)
    assert known.any() and not (known & ~free.reshape(-1)).any()
    np.testing.assert_array_equal(
        box.restrict(GRID.unflatten(values))[box.nodes(at)], values[at]
    )


def test_large_boxes_are_the_grid():
    free = torso(GRID)
    everywhere = np.flatnonzero(free)
    assert Subdomain.around(GRID, everywhere).is_whole
    assert Subdomain.around(GRID, None).is_whole
    assert Subdomain.around(GRID, everywhere[:0]).is_whole
    ring = np.ravel_multi_index((8, np.arange(GRID.shape[1]), 20), GRID.shape)
    around = Subdomain.around(GRID, ring)
    assert around.shape[1] == GRID.shape[1] and not around.is_whole


def test_levels_of_the_last_box_serve_the_next_solve_there():
    """With vectors of their own; another box has its own levels."""
    free = torso(GRID)
    free[:, 32, 14] = False  # so that boxes of equal shape differ
    here, there = patch(GRID, free, 30), patch(GRID, free, 34)
    assert Subdomain.around(GRID, here).shape == Subdomain.around(GRID, there).shape
    b = np.random.default_rng(0).normal(size=len(here))
    solver = Multigrid(GRID, free)
    assert not solver.hierarchy.boxes
    first = solver.preconditioner(here)
    (levels,) = solver.hierarchy.boxes.values()
    again = solver.preconditioner(here)
    assert [*solver.hierarchy.boxes.values()] == [levels]
    answer = run(first, here, b)
    assert not again.x.any()
    np.testing.assert_array_equal(run(again, here, b), answer)
    for voxels in (there, here):
        fresh = Multigrid(GRID, free).preconditioner(voxels)
        cycle = solver.preconditioner(voxels)
        np.testing.assert_array_equal(cycle.free, fresh.free)
        load = np.ones(len(voxels))
        np.testing.assert_array_equal(
            run(cycle, voxels, load), run(fresh, voxels, load)
        )


@pytest.mark.parametrize("pooled", [False, True])
@pytest.mark.parametrize("spoke", [30, 0, 62])
def test_v_cycle_nearly_inverts_the_box(spoke, pooled):
    """With zero around the box, and pooled blocks of pooled voxels."""
    free = torso(GRID)
    flat = free.reshape(-1)
    near = patch(GRID, free, spoke)
    joined = np.zeros(GRID.n_voxels, dtype=bool)
    if pooled:  # every third pair of voxels of the patch, along its spoke
        stride = GRID.strides[0]
        own = near[np.isin(near + stride, near) & ~np.isin(near - stride, near)]
        joined[own[::3]] = True
        shown = flat & ~np.roll(joined, stride)
        blocks = PooledBlocks.of(flat, joined, shown, stride)
    else:
        shown, blocks = flat, None
    cycle = Multigrid(GRID, free, blocks=blocks).preconditioner(near)
    assert 0 < cycle.free.sum() < 0.5 * flat.sum()
    number = np.full(GRID.n_voxels, -1)
    at = np.flatnonzero(cycle.free & shown)
    number[at] = np.arange(len(at))
    inner = np.roll(number, GRID.strides[0])
    heads = np.where(np.roll(joined, GRID.strides[0]), inner, number)[cycle.free]
    P = sp.csr_array((np.ones(len(heads)), (np.arange(len(heads)), heads)))
    A = sp.csc_array(P.T @ explicit(GRID, GRID.unflatten(cycle.free)) @ P)
    b = np.random.default_rng(1).normal(size=len(at))
    B = LinearOperator(A.shape, matvec=lambda v: run(cycle, at, v.ravel()), dtype=float)
    steps: list[int] = []
    x, failed = cg(A, b, rtol=1e-6, M=B, callback=lambda _: steps.append(1))
    assert failed == 0 and len(steps) <= (12 if pooled else 8)
    np.testing.assert_allclose(x, splu(A).solve(b), atol=1e-4 * np.abs(x).max())


@pytest.mark.slow
def test_zero_around_a_box_hardly_matters_near_its_voxels():
    """What loads of the patch do there keeps its energy, but for the widest one."""
    free = torso(GRID)
    near = patch(GRID, free, 0)
    whole = Multigrid(GRID, free)
    box = Subdomain.around(GRID, near)
    part = Multigrid(GRID, free & GRID.unflatten(box.extend(box.free(free))))
    loads = np.zeros((len(near), GRID.n_voxels))
    loads[np.arange(len(near)), near] = 1.0
    r = GRID.r.repeat(GRID.strides[0])
    grams = []
    for solver in (part, whole):
        fields = np.array(
            [r * v.x for v in (solver.solve(load, rtol=1e-8) for load in loads)]
        )
        grams.append(fields @ fields.T)
    ratios = scipy.linalg.eigh(*grams, eigvals_only=True)
    assert 0.5 < ratios.min() < ratios.max() < 1.01
    assert ratios[1] > 0.75
