"""One V-cycle as a map: linear, symmetric, positive definite, near the inverse."""

from collections import deque

import numpy as np
import scipy.linalg

from tests.laplace.multigrid.conftest import noise
from ttus_opt.laplace.multigrid import Added, OneCycle


def written_out(cycle, free):
    """Its matrix over the free voxels, column by column."""
    columns = []
    for n in np.flatnonzero(free):
        unit = np.zeros(free.size)
        unit[n] = 1.0
        columns.append(cycle.solve(unit).x)
    return np.array(columns)[:, free]


def test_it_is_spectrally_equivalent_to_the_inverse(small):
    free = small.free.reshape(-1)
    at = np.flatnonzero(free)
    A = small.A[np.ix_(at, at)]
    # screening comes with the conductances of the symmetric block
    for screening in (0.0, 0.5 * np.diag(A).max()):
        added = Added(np.full(small.grid.shape, screening)) if screening else None
        B = written_out(OneCycle(small.grid, small.free, added=added), free)
        assert np.abs(B - B.T).max() < 1e-4 * np.abs(B).max()
        exact = np.linalg.inv(A + screening * np.eye(len(A)))
        ratios = scipy.linalg.eigh((B + B.T) / 2, exact, eigvals_only=True)
        assert 0.6 < ratios.min() <= ratios.max() < (1.4 if screening else 1.1)


def test_it_is_linear_and_leaves_fixed_voxels_alone(small):
    free = small.free.reshape(-1)
    cycle = OneCycle(small.grid, small.free)
    a, b = noise(small.free), noise(small.free, 1)
    together = cycle.solve(2.0 * a - 1e-6 * b).x
    apart = 2.0 * cycle.solve(a).x - 1e-6 * cycle.solve(b).x
    assert np.abs(together - apart).max() < 1e-5 * np.abs(apart).max()
    assert not together[~free].any()
    assert not cycle.solve(np.zeros(free.size)).x.any()
    assert cycle.solve(a).iterations == 1


class Taken(deque):
    """What another thread empties between a look and a grip."""

    def __bool__(self):
        return True


def test_two_threads_do_not_take_the_same_scratch_arrays(small):
    cycle, b = OneCycle(small.grid, small.free), noise(small.free)
    alone = cycle.solve(b).x
    cycle._idle = Taken()
    np.testing.assert_array_equal(cycle.solve(b).x, alone)
