"""A V-cycle as the linear map that its parts make, against dense algebra."""

import numpy as np
import pytest
import scipy.linalg

from tests.laplace.multigrid.conftest import made, noise, split
from tests.laplace.multigrid.test_solver import box, explicit, make_grid
from ttus_opt.core.arrays import Array
from ttus_opt.laplace.multigrid.hierarchy import Hierarchy
from ttus_opt.laplace.multigrid.workspace import Workspace


def applied(work: Workspace, hierarchy: Hierarchy, free: np.ndarray, b: Array) -> Array:
    """One V-cycle on values at free voxels."""
    layout = hierarchy.levels[0].layout
    places = layout.places(np.nonzero(free))
    work.b.fill(0.0)
    work.b.reshape(-1)[places] = split(layout, b).reshape(-1)[places]
    work.v_cycle()
    return work.x.reshape(-1)[places].astype(float)


@pytest.mark.parametrize("shape", [(5, 4, 5), (6, 5, 4)])
def test_a_single_level_is_solved_exactly(shape):
    grid = make_grid(shape)
    free = box(grid)
    h = Hierarchy.build(grid, free)
    assert len(h.levels) == 1
    b = noise(free)
    expected = np.linalg.solve(explicit(grid, free).toarray(), b[free.reshape(-1)])
    x = applied(Workspace(h), h, free, b)
    np.testing.assert_allclose(x, expected, rtol=1e-4, atol=1e-5 * np.abs(x).max())


def test_the_map_is_symmetric_and_near_the_inverse():
    """All of B as a matrix: eigenvalues of B A near one."""
    small = made((10, 12, 8))
    free, h = small.free, small.hierarchy
    assert len(h.levels) > 1
    at, work = np.flatnonzero(free), Workspace(h)
    unit = np.zeros(free.size)
    B = np.empty((len(at), len(at)))
    for n, voxel in enumerate(at):
        unit[voxel] = 1.0
        B[:, n] = applied(work, h, free, unit)
        unit[voxel] = 0.0
    np.testing.assert_allclose(B, B.T, atol=1e-5 * np.abs(B).max())
    A = small.A[np.ix_(at, at)]
    values = scipy.linalg.eigh(A @ ((B + B.T) / 2.0) @ A, A, eigvals_only=True)
    assert 0.6 < values.min() <= values.max() < 1.1
