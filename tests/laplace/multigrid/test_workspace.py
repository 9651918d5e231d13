"""A V-cycle and a solve by several cores at a time, against one core's, bit by bit."""

import numpy as np
import pytest

from tests.laplace.multigrid.conftest import made, noise, split
from tests.laplace.multigrid.test_solver import make_grid, torso
from ttus_opt.laplace.multigrid import solver, workspace
from ttus_opt.laplace.multigrid.hierarchy import Hierarchy
from ttus_opt.laplace.multigrid.solver import Multigrid
from ttus_opt.laplace.multigrid.workspace import Workspace


def share(monkeypatch, cores, large=0):
    """From now on there are so many cores, and levels are large from this size on."""
    for module in (solver, workspace):
        monkeypatch.setattr(module, "LARGE", large)
    monkeypatch.setattr("ttus_opt.core.threads.usable_cores", lambda: cores)


def cycled(work, b, sweeps, has_red):
    work.b[:] = b
    work.v_cycle(sweeps=sweeps, has_red=has_red)
    return work.x.copy()


# several tiles of lines; even and odd numbers of spokes; layers coarsened or not
@pytest.mark.parametrize("shape", [(13, 60, 80), (24, 61, 70), (5, 64, 64)])
@pytest.mark.parametrize(("sweeps", "has_red"), [(1, False), (2, True)])
def test_a_v_cycle_does_not_depend_on_the_number_of_cores(
    shape, sweeps, has_red, monkeypatch
):
    grid = make_grid(shape)
    free = torso(grid)
    h = Hierarchy.build(grid, free)
    b = split(h.levels[0].layout, noise(free))
    alone = cycled(Workspace(h), b, sweeps, has_red)
    assert np.any(alone)
    for cores in (2, 3, 5):
        share(monkeypatch, cores)
        work = Workspace(h)
        assert max(work._parts) == cores
        for _ in range(2):  # scratch space of the first does not reach the second
            x = cycled(work, b, sweeps, has_red)
            np.testing.assert_array_equal(x, alone)


def solved():
    """Solutions on grids with even and odd numbers of spokes."""
    found = []
    for shape in ((10, 12, 8), (9, 11, 7)):
        small = made(shape)
        multigrid = Multigrid(small.grid, small.free)
        x = multigrid.solve(noise(small.free)).x
        found += [x, multigrid.solve(noise(small.free, 1)).x]
    return found


@pytest.mark.parametrize("cores", [2, 4])
def test_a_solve_does_not_depend_on_the_number_of_cores(cores, monkeypatch):
    alone = solved()
    share(monkeypatch, cores)
    for x, expected in zip(solved(), alone, strict=True):
        np.testing.assert_array_equal(x, expected)


def test_one_core_does_small_levels(monkeypatch):
    grid = make_grid((24, 32, 24))
    h = Hierarchy.build(grid, torso(grid))
    sizes = [level.inverse.size for level in h.levels]
    assert len(sizes) > 2
    share(monkeypatch, 4, large=sizes[0])
    assert Workspace(h)._parts == [4] + [1] * (len(sizes) - 1)
    assert Workspace(h).values.nbytes > 4 * h.work_size
    share(monkeypatch, 4, large=sizes[0] + 1)
    assert Workspace(h).values.nbytes == 4 * h.work_size
