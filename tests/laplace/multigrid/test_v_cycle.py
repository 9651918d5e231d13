"""The V-cycle as a preconditioner: where voxels lie, and what a box knows."""

import numpy as np

from tests.laplace.multigrid.conftest import noise, split
from ttus_opt.laplace.multigrid import OneCycle, VCycle
from ttus_opt.laplace.multigrid.workspace import Workspace


def test_it_is_the_workspaces_cycle_on_flat_vectors(small):
    free = small.free.reshape(-1)
    cycle = OneCycle(small.grid, small.free).preconditioner()
    np.testing.assert_array_equal(cycle.free, free)
    at, b = np.flatnonzero(free), noise(small.free)
    cycle.b[cycle.places(at)] = b[at]
    cycle.run()
    work, layout = Workspace(small.hierarchy), small.hierarchy.levels[0].layout
    own = layout.places(np.nonzero(small.free))
    work.b.reshape(-1)[own] = split(layout, b).reshape(-1)[own]
    work.v_cycle()
    np.testing.assert_array_equal(cycle.x[cycle.places(at)], work.x.reshape(-1)[own])
    forward = cycle.x.copy()
    cycle.run_adjoint()
    np.testing.assert_array_equal(cycle.x, forward)


def test_more_sweeps_come_nearer(small):
    free = small.free.reshape(-1)
    at, b = np.flatnonzero(free), noise(small.free, 1)
    exact = np.linalg.solve(small.A[np.ix_(at, at)], b[at])
    errors = []
    for sweeps in (1, 2, 4):
        part = OneCycle(small.grid, small.free).preconditioner()
        cycle = VCycle(small.hierarchy, part._subdomain, free, sweeps=sweeps)
        cycle.b[cycle.places(at)] = b[at]
        cycle.run()
        errors.append(float(np.linalg.norm(cycle.x[cycle.places(at)] - exact)))
    assert errors[0] > errors[1] > errors[2]
    assert errors[0] < 0.3 * np.linalg.norm(exact)
