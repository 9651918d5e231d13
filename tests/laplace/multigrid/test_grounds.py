"""Links cut by a boundary, against the same matrix written down and solved directly."""

import pickle

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from tests.kit import torso
from tests.laplace.multigrid.test_solver import product
from ttus_opt.laplace.multigrid import Added, Grounds, Multigrid, OneCycle
from ttus_opt.laplace.multigrid.subdomain import Subdomain
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.voxmap.voxmap import Voxmap


@pytest.fixture(
    scope="module", params=[(14, 24, 15), (11, 15, 12)], ids=["even", "odd"]
)
def system(request):
    return LaplaceSystem.assemble(Voxmap.from_surface(torso(), shape=request.param))


def block(system):
    """A from the rows of L."""
    free = system.free
    A = sp.diags_array(-system.radii[free]) @ system.L[free][:, free]
    return sp.csr_array(A)


def test_the_block_is_symmetric_and_positive_definite(system):
    """Symmetric, connected and diagonally dominant with no link below zero."""
    A = block(system)
    assert abs(A - A.T).max() <= 1e-15
    assert sp.csr_array(A - sp.diags_array(A.diagonal())).max() <= 0.0
    assert (A.sum(axis=1) >= -1e-15).all()
    assert (A.diagonal() > 0.0).all()


def test_a_solve_is_the_direct_one(system):
    free, rng = system.free, np.random.default_rng(0)
    b = np.where(free, rng.normal(size=len(free)), 0.0)
    answer = system.multigrid.solve(b)
    expected = spsolve(sp.csc_array(block(system)), b[free])
    np.testing.assert_allclose(answer.x[free], expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(
        product(system.multigrid, answer.x)[free], b[free], rtol=0, atol=1e-10
    )
    staircase = LaplaceSystem.assemble(
        Voxmap.from_surface(torso(), shape=system.grid.shape, boundary="staircase")
    )
    at_most = staircase.multigrid.solve(np.where(staircase.free, b, 0.0)).iterations
    assert answer.iterations <= at_most + 2


def test_both_adjoints(system):
    g = np.random.default_rng(1).normal(size=len(system.free))
    np.testing.assert_allclose(system.L @ system.solve(g), g, rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        system.L.T @ system.solve_adjoint(g), g, rtol=0, atol=1e-9
    )


def test_a_pickle_solves_the_same(system):
    b = np.where(system.free, 1.0, 0.0)
    again = pickle.loads(pickle.dumps(system.multigrid))
    np.testing.assert_array_equal(again.solve(b).x, system.multigrid.solve(b).x)


def test_a_part_of_the_grid_has_its_own(system):
    """Places and changes there, found voxel by voxel."""
    grid, grounds = system.grid, system.grounds
    part = Subdomain(grid, (3, grid.shape[1] - 4, 2), (6, 8, 7))
    dense = np.zeros((3, grid.n_voxels))
    dense[:, grounds.voxels] = grounds.changes.T
    inside = grounds.within(part)
    assert (np.diff(inside.voxels) > 0).all()
    own = np.zeros((3, 6 * 8 * 7))
    own[:, inside.voxels] = inside.changes.T
    for values, expected in zip(own, dense, strict=True):
        cut = part.restrict(grid.unflatten(expected))
        np.testing.assert_array_equal(values.reshape(6, 8, 7), cut)
    assert own.any()


def test_one_cycle_is_near_the_inverse(system):
    """Without the grounds it would be off by tens of per cent at the surface."""
    free = system.free
    x = np.where(free, 1.0, 0.0)
    b = product(system.multigrid, x)
    grid = system.grid
    cycle = OneCycle(grid, grid.unflatten(free), added=Added(grounds=system.grounds))
    assert np.abs(cycle.solve(b).x - x)[free].max() < 0.2


def test_grounds_of_fixed_voxels_do_not_count():
    """A voxel that is held besides takes its own cut links along."""
    system = LaplaceSystem.assemble(Voxmap.from_surface(torso(), shape=(11, 16, 9)))
    held = system.free.copy()
    held[system.grounds.voxels[::2]] = False
    grid = system.grid
    less = Multigrid(grid, grid.unflatten(held), added=system.added)
    free = held
    A = sp.diags_array(-system.radii[free]) @ system.L[free][:, free]
    b = np.where(free, 1.0, 0.0)
    expected = spsolve(sp.csc_array(A), b[free])
    np.testing.assert_allclose(less.solve(b).x[free], expected, rtol=0, atol=1e-10)


def test_where_keeps_order():
    grounds = Grounds(np.array([1, 3, 5]), np.arange(9.0).reshape(3, 3))
    kept = grounds.where(np.array([True, False, False, True, True, True]))
    np.testing.assert_array_equal(kept.voxels, [3, 5])
    np.testing.assert_array_equal(kept.changes, [[3.0, 4.0, 5.0], [6.0, 7.0, 8.0]])
