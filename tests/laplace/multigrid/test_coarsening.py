"""Networks of conductances against the operator written down, and dense elimination."""

import numpy as np
import pytest

from tests.laplace.multigrid.test_solver import box, make_grid
from ttus_opt.laplace.multigrid.coarsening import THETA, R, Z, coarsen, finest, plan


def test_the_finest_network_is_the_operator(small):
    at = np.flatnonzero(small.free)
    A = finest(small.grid, small.free).matrix()
    np.testing.assert_allclose(A, small.A[np.ix_(at, at)], rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("axis", [R, THETA, Z])
def test_a_line_is_coarsened_by_eliminating_its_nodes(axis):
    """Without links across, coarsening is the Schur complement, cell by cell."""
    grid = make_grid((9, 12, 9))
    free = box(grid)
    free[4, 5, 6] = False
    whole = finest(grid, free)

    def along(values):
        return tuple(v if a == axis else 0.0 * v for a, v in enumerate(values))

    line = whole.__class__(
        free, along(whole.links), along(whole.grounds), whole.positions, whole.turn
    )
    coarse = coarsen(line, axis)
    kept = coarse.positions[axis].astype(int)
    stays = np.isin(np.indices(grid.shape)[axis], kept)[free]
    A = line.matrix()
    inner = A[np.ix_(~stays, ~stays)]
    schur = A[np.ix_(stays, stays)] - A[np.ix_(stays, ~stays)] @ np.linalg.solve(
        inner, A[np.ix_(~stays, stays)]
    )
    np.testing.assert_allclose(coarse.matrix(), schur, rtol=1e-4, atol=1e-6)


def test_conductances_grow_with_the_width_of_the_cells():
    grid = make_grid((9, 12, 9))
    network = finest(grid, box(grid))
    coarse = coarsen(network, Z)
    inner = np.s_[3, 4, 1:-1]
    np.testing.assert_allclose(
        coarse.links[R][inner], 2.0 * network.links[R][3, 4, 2:-2:2]
    )
    assert network.cells(THETA).sum() == pytest.approx(network.turn)


def test_a_surface_between_coarse_nodes_stays_closed():
    grid = make_grid((17, 16, 9))
    free = box(grid)
    free[7] = False  # a node that the next level drops
    network = finest(grid, free)
    for _ in range(2):
        network = coarsen(network, R)
        cut = int(np.flatnonzero(network.positions[R] < 7)[-1])
        assert not network.links[R][cut].any()
        assert network.grounds[R][cut, :, 1:-1].all()  # at its distance


def test_the_plan_takes_the_narrow_directions_first():
    flags = list(plan(make_grid((16, 16, 60), z_max=0.02)))
    assert flags[0] == (False, False, True)
    counts = np.array([16, 16, 60])
    for chosen in flags:
        halved = np.where([False, True, False], (counts + 1) // 2, counts // 2 + 1)
        counts = np.where(chosen, halved, counts)
    assert (counts <= [3, 5, 3]).all()


@pytest.mark.parametrize("axis", [R, THETA, Z])
def test_weights_are_the_elimination_read_backwards(axis):
    """What a dropped node gets from the one before and the one after it."""
    grid = make_grid((9, 12, 9))
    network = finest(grid, box(grid))
    before, after = network.weights(axis)
    node = np.array([3, 4, 5])
    back, here = node.copy(), tuple(node)
    back[axis] -= 1
    a, b = network.links[axis][tuple(back)], network.links[axis][here]
    assert before[here] == pytest.approx(a / (a + b), rel=1e-6)
    assert after[here] == pytest.approx(b / (a + b), rel=1e-6)
    # links along r grow outwards
    assert (after[here] > before[here]) == (axis == R)
    # next to the rim one half comes from a fixed node: nothing
    first = tuple(np.where(np.arange(3) == axis, 1, node))
    if axis != THETA:
        assert before[first] == 0.0 and 0.4 < after[first] < 0.6
