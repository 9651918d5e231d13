"""The multigrid solver against sparse factorisations, on well and ill-shaped masks."""

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.linalg import splu

import ttus_opt as tt
from tests.kit import InputError, NumericalError, refuses, shared_data
from ttus_opt.laplace.multigrid import Multigrid, refinement
from ttus_opt.laplace.multigrid import solver as solver_module
from ttus_opt.laplace.multigrid.workspace import Workspace
from ttus_opt.voxmap.grid import CylindricalGrid


def make_grid(shape, **limits):
    values = {"r_inner": 0.03, "r_outer": 0.18, "z_min": 0.0, "z_max": 0.3} | limits
    return CylindricalGrid(**values, shape=shape)


def box(grid):
    """Everything free except the rim."""
    free = np.ones(grid.shape, dtype=bool)
    free[[0, -1]] = False
    free[:, :, [0, -1]] = False
    return free


def explicit(grid, free):
    """A written down neighbour by neighbour (docs/method, 4.3), on free voxels."""
    number = np.full(grid.shape, -1)
    number[free] = np.arange(free.sum())
    dr, dt, dz = grid.r_step, grid.theta_step, grid.z_step
    i, j, k = np.nonzero(free)
    r, me = grid.r[i], number[free]
    neighbours = [
        (i - 1, j, k, r - dr / 2),
        (i + 1, j, k, r + dr / 2),
        (i, (j - 1) % grid.shape[1], k, dr**2 / (r * dt**2)),
        (i, (j + 1) % grid.shape[1], k, dr**2 / (r * dt**2)),
        (i, j, k - 1, r * dr**2 / dz**2),
        (i, j, k + 1, r * dr**2 / dz**2),
    ]
    A = sp.coo_array((len(me), len(me)))
    for *voxel, weight in neighbours:
        other = number[tuple(voxel)]
        linked = other >= 0
        A += sp.coo_array((weight, (me, me)), shape=A.shape)
        places = me[linked], other[linked]
        A -= sp.coo_array((weight[linked], places), shape=A.shape)
    return sp.csc_array(A)


def torso(grid):
    """Free voxels around a closed, bumpy surface layer."""
    theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
    n = 2.5
    radius = (
        np.abs(np.cos(theta) / 0.16) ** n + np.abs(np.sin(theta) / 0.115) ** n
    ) ** (-1 / n)
    radius *= 1.0 - 0.08 * np.cos(2 * np.pi * z / grid.z[-1])
    inside = grid.r[:, None, None] < radius[None]
    free = box(grid)
    for axis in range(3):
        for side in (1, -1):
            free &= ~(~inside & np.roll(inside, side, axis))
    return free


def touching(grid):
    """A surface that leaves the grid on one side and meets the inner layer."""
    free = box(grid)
    at = (
        np.round((grid.shape[0] - 1) * (0.5 + 0.6 * np.sin(grid.theta)))
        .astype(int)
        .clip(0, grid.shape[0] - 1)
    )
    for j, i in enumerate(at):
        free[max(i - 1, 0) : i + 2, j] = False
    return free


def pockets(grid):
    """Free voxels cut off from everything, singly and in groups."""
    free = torso(grid)
    free[5:9, 3:9, 3:8] = False
    free[6:8, 4:6, 4:6] = True
    free[7, 7, 7] = True
    free[11, 11, 5:9] = True
    free[10, 11, 5:9] = free[12, 11, 5:9] = False
    return free


def neck(grid):
    """Two chambers joined by one voxel, and one joined by a long thin pipe."""
    free = box(grid)
    free[:, :, grid.shape[2] // 2] = False
    free[grid.shape[0] // 2, 3, grid.shape[2] // 2] = True
    free[grid.shape[0] // 3] = False
    free[grid.shape[0] // 3, 5, 3] = True
    free[:, 10:16] = False
    free[7, 10:16, 4] = True
    return free


def slices(grid):
    """Chambers one voxel thin, in every direction."""
    free = box(grid)
    third = grid.shape[0] // 3
    free[:third, :, ::2] = False
    free[third : 2 * third : 2] = False
    free[2 * third :, ::2] = False
    return free


def random_mask(grid):
    """30 % of the voxels fixed, at random."""
    return box(grid) & (np.random.default_rng(1).random(grid.shape) > 0.3)


MASKS = [box, torso, touching, pockets, neck, slices, random_mask]
#: Even, odd spokes, nothing divisible; tall, flat and slim ones
GRIDS = {
    "even": make_grid((16, 24, 14)),
    "odd": make_grid((17, 25, 13)),
    "prime": make_grid((15, 29, 17)),
    "tall": make_grid((14, 20, 40), z_max=1.5),
    "flat": make_grid((14, 20, 30), z_max=0.02),
    "shell": make_grid((30, 26, 12), r_inner=0.17),
    "core": make_grid((14, 40, 12), r_inner=0.007),
}


def noise(free, seed=0):
    """White noise on the free voxels, shape (V,)."""
    values = np.random.default_rng(seed).standard_normal(free.shape)
    return np.where(free, values, 0.0).reshape(-1)


def one_cycle(solver, b):
    """A V-cycle's answer to b, both of shape (V,); zero at fixed voxels."""
    at, cycle = np.flatnonzero(solver.free), solver.preconditioner()
    x = np.zeros_like(b)
    places = cycle.places(at)
    cycle.b[places] = b[at]
    cycle.run()
    x[at] = cycle.x[places]
    return x


@pytest.fixture(params=["even", "odd"])
def case(request):
    grid = GRIDS[request.param]
    free = torso(grid)
    return grid, free, Multigrid(grid, free)


#: Every mask on every grid, half of them quick to have: each mask and each grid is
PAIRS = [
    pytest.param(mask, name, marks=pytest.mark.slow if (i + j) % 2 else ())
    for i, mask in enumerate(MASKS)
    for j, name in enumerate(GRIDS)
]


@pytest.mark.parametrize(("mask", "name"), PAIRS)
def test_equals_a_factorisation(mask, name):
    grid = GRIDS[name]
    free = mask(grid)
    A = explicit(grid, free)
    b = noise(free)
    result = Multigrid(grid, free).solve(b, rtol=1e-12)
    known = b[free.reshape(-1)]
    found = result.x[free.reshape(-1)]
    expected = splu(A).solve(known)
    assert np.all(result.x[~free.reshape(-1)] == 0.0)
    assert np.linalg.norm(found - expected) < 1e-10 * np.linalg.norm(expected)
    residual = np.linalg.norm(known - A @ found) / np.linalg.norm(known)
    assert residual <= 1.01e-12
    assert result.relative_residual == pytest.approx(residual, rel=0.1, abs=5e-14)


@settings(max_examples=25)
@given(
    shape=st.tuples(st.integers(4, 14), st.integers(4, 14), st.integers(3, 14)),
    fixed=st.floats(0.0, 0.9),
    height=st.floats(0.01, 3.0),
    seed=st.integers(0, 1000),
)
def test_equals_a_factorisation_on_any_mask(shape, fixed, height, seed):
    grid = make_grid(shape, z_max=height)
    free = box(grid) & (np.random.default_rng(seed).random(shape) >= fixed)
    b = noise(free, seed)
    x = Multigrid(grid, free).solve(b).x
    if free.any():
        expected = splu(explicit(grid, free)).solve(b[free.reshape(-1)])
        error = np.linalg.norm(x[free.reshape(-1)] - expected)
        assert error <= 1e-10 * np.linalg.norm(expected)
    else:
        assert not x.any()


@pytest.mark.parametrize("mask", MASKS)
def test_cycles_stay_few_on_ill_shaped_masks(mask):
    grid = make_grid((24, 72, 30))
    free = mask(grid)
    assert Multigrid(grid, free).solve(noise(free), rtol=1e-10).iterations <= 16


def test_cycles_hardly_grow_with_the_grid():
    cycles = []
    for shape in ((12, 36, 15), (24, 72, 30), (48, 144, 60)):
        grid = make_grid(shape)
        free = torso(grid)
        cycles.append(Multigrid(grid, free).solve(noise(free), rtol=1e-10).iterations)
    assert max(cycles) <= 16
    assert max(cycles) <= 1.4 * min(cycles)  # for 64 times as many voxels


def test_a_surface_costs_no_more_cycles_than_none():
    grid = make_grid((48, 100, 40))
    cycles = [
        Multigrid(grid, free).solve(noise(free), rtol=1e-10).iterations
        for free in (box(grid), torso(grid))
    ]
    assert cycles[1] <= cycles[0] + 1


def test_the_phantom_surface():
    path = shared_data("phantom/surface.nc")
    voxmap = tt.Voxmap.from_surface(tt.Surface.load(path), shape=(48, 120, 60))
    solver = Multigrid(voxmap.grid, ~voxmap.dirichlet)
    b = noise(~voxmap.dirichlet)
    result = solver.solve(b, rtol=1e-12)
    assert result.iterations <= 20
    residual = np.linalg.norm(b - product(solver, result.x)) / np.linalg.norm(b)
    assert residual <= 1.01e-12


def product(solver, x):
    """A x as residuals are computed."""
    out = np.zeros_like(x)
    refinement.operate(out, np.where(solver.free, x, 0.0), solver._operator, (0, 1))
    return out


def test_products_are_those_of_the_operator(case):
    grid, free, solver = case
    x = np.random.default_rng(3).standard_normal(grid.n_voxels)
    expected = np.zeros(grid.shape)
    expected[free] = explicit(grid, free) @ x.reshape(grid.shape)[free]
    np.testing.assert_allclose(
        product(solver, x), expected.reshape(-1), atol=1e-13 * np.abs(expected).max()
    )


def test_the_norm_bound_holds(case):
    grid, free, solver = case
    largest = sp.linalg.eigsh(explicit(grid, free), 1, return_eigenvectors=False)[0]
    assert largest <= solver.norm_bound <= 3.0 * largest


def test_nothing_is_left_over_from_the_cycle_before(case):
    _, free, solver = case
    expected = one_cycle(solver, noise(free, 3))
    at, cycle = np.flatnonzero(free), solver.preconditioner()
    places = cycle.places(at)
    for seed in (4, 3):
        cycle.b[places] = noise(free, seed)[at]
        cycle.run()
    np.testing.assert_array_equal(cycle.x[places], expected[at].astype(np.float32))


@pytest.mark.parametrize("shape", [(16, 24, 14), (17, 25, 13), (4, 4, 3)])
def test_a_cycle_without_red_loads_takes_them_for_zero(shape):
    """Also where the finest level is the coarsest."""
    grid = make_grid(shape)
    free = torso(grid) if shape[0] > 4 else box(grid)
    hierarchy = Multigrid(grid, free).hierarchy
    work, plain = Workspace(hierarchy), Workspace(hierarchy)
    layout = hierarchy.levels[0].layout
    b = layout.split(noise(free, 4).reshape(free.shape).astype(np.float32))
    plain.b[1] = work.b[1] = b[1]
    work.b[0] = b[0]
    work.v_cycle(has_red=False)
    plain.v_cycle()
    np.testing.assert_array_equal(work.x, plain.x)
    work.v_cycle()
    assert not np.array_equal(work.x, plain.x)


@pytest.mark.parametrize("scale", [1e-300, 1e-30, 1e30, 1e300])
def test_units_do_not_matter(scale, case):
    _, free, solver = case
    b = noise(free)
    expected = solver.solve(b).x
    np.testing.assert_allclose(
        solver.solve(scale * b).x / scale, expected, atol=1e-10 * np.abs(expected).max()
    )


def test_smooth_right_sides_reach_rounding(case):
    _, free, solver = case
    x = free.astype(float).reshape(-1)
    b = product(solver, x)
    result = solver.solve(b, rtol=0.0)
    np.testing.assert_allclose(result.x, x, atol=1e-11)
    floor = solver.norm_bound * np.linalg.norm(x) / np.linalg.norm(b) + 1.0
    assert result.relative_residual <= 2.3e-16 * floor


def test_nothing_to_solve():
    grid = make_grid((8, 16, 5))
    nothing = np.zeros(grid.shape, dtype=bool)
    result = Multigrid(grid, nothing).solve(np.ones(grid.n_voxels))
    assert not result.x.any() and result.iterations == 0
    assert result.relative_residual == 0.0
    solver = Multigrid(grid, box(grid))
    assert not solver.solve(np.zeros(grid.n_voxels)).x.any()
    assert not one_cycle(solver, np.zeros(grid.n_voxels)).any()


@pytest.mark.parametrize("shape", [(4, 4, 3), (4, 5, 4), (5, 7, 3), (6, 4, 40)])
def test_smallest_grids(shape):
    grid = make_grid(shape)
    free = box(grid)
    b = noise(free)
    expected = splu(explicit(grid, free)).solve(b[free.reshape(-1)])
    found = Multigrid(grid, free).solve(b).x[free.reshape(-1)]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_values_at_fixed_voxels_are_left_out(case):
    _, free, solver = case
    b = noise(free)
    dirty = np.where(free.reshape(-1), b, np.nan)
    assert np.array_equal(solver.solve(dirty).x, solver.solve(b).x)


def test_bad_input_is_refused():
    grid = GRIDS["even"]
    solver = Multigrid(grid, box(grid))
    b = noise(box(grid))
    refuses(InputError, "shape", solver.solve, b[1:])
    bad = b.copy()
    bad[np.flatnonzero(b)[5]] = np.nan
    refuses(InputError, "finite", solver.solve, bad)
    refuses(InputError, "finite", solver.solve, np.where(np.isnan(bad), np.inf, bad))
    refuses(InputError, "rtol", solver.solve, b, rtol=-1.0)
    refuses(InputError, "layer", Multigrid, grid, np.ones(grid.shape, dtype=bool))
    refuses(InputError, "boolean", Multigrid, grid, np.zeros(grid.shape))


def test_too_few_cycles_are_told(monkeypatch):
    grid = GRIDS["odd"]
    solver = Multigrid(grid, box(grid))
    b = noise(box(grid))
    with pytest.raises(NumericalError, match=r"after 3 cycles, 1\.0e-12") as error:
        monkeypatch.setattr(solver_module, "MOST_CYCLES", 3)
        solver.solve(b, rtol=1e-12)
    monkeypatch.undo()
    assert "\n" not in str(error.value)
    assert solver.solve(b).relative_residual <= 1e-12  # and leave nothing behind


def test_several_at_once_equal_one_by_one(case):
    _, free, solver = case
    rows = np.stack([noise(free, seed) for seed in range(6)])
    alone = [solver.solve(row).x for row in rows]
    with ThreadPoolExecutor(4) as pool:
        again = list(pool.map(solver.solve, [*rows, *rows]))
    for one, result in zip([*alone, *alone], again, strict=True):
        assert np.array_equal(result.x, one)


def test_pickles(case):
    _, free, solver = case
    b = noise(free)
    twin = pickle.loads(pickle.dumps(solver))
    assert np.array_equal(twin.solve(b).x, solver.solve(b).x)


def second_level(grid):
    return Multigrid(grid, box(grid)).hierarchy.levels[1].layout.shape


def test_levels_follow_the_steps():
    assert second_level(make_grid((48, 120, 60))) == (25, 60, 31)
    # slices far apart against spokes: θ first
    tall = make_grid((16, 64, 20), z_max=3.0)
    assert second_level(tall) == (9, 32, 20)
    # slices close together: z first, r not while its step is the longest
    flat = make_grid((16, 16, 60), z_max=0.02)
    assert second_level(flat) == (16, 16, 31)
