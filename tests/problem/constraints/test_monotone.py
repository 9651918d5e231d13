"""Growth with depth: its rows against plain loops, and what it does to a field."""

import itertools

import numpy as np

from tests.problem.constraints.declared import REGION, SCENE, linear
from tests.refusals import refuses
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.batch import fit
from ttus_opt.problem.constraints.monotone import Monotone
from ttus_opt.voxmap.voxmap import INSIDE, SURFACE


def test_monotone_rows_are_the_pairs_of_each_spoke():
    rows = linear(Monotone(SCENE, 2.0).rows())
    grid, fixed = SCENE.voxmap.grid, SCENE.voxmap.dirichlet
    at = np.arange(grid.n_voxels).reshape(grid.shape)
    expected = set()
    n_r, n_theta, n_z = grid.shape
    for i, j, k in itertools.product(range(n_r - 1), range(n_theta), range(n_z)):
        deep, shallow = REGION[i, j, k], REGION[i + 1, j, k]
        given = fixed[i, j, k] and fixed[i + 1, j, k]
        if deep == INSIDE and shallow in (INSIDE, SURFACE) and not given:
            expected.add((at[i, j, k], at[i + 1, j, k]))
    matrix = rows.blocks["p"]
    found = set()
    for row in range(matrix.shape[0]):
        part = slice(matrix.indptr[row], matrix.indptr[row + 1])
        assert matrix.data[part].tolist() == [1.0, -1.0]
        found.add(tuple(matrix.indices[part].tolist()))
    assert found == expected
    deep = matrix.indices[::2]
    i, j, k = np.unravel_index(deep, grid.shape)
    radius = SCENE.voxmap.surface.radius_at(grid.theta[j], grid.z[k])
    last = REGION[i + 1, j, k] == SURFACE
    distance = np.where(last, radius - grid.r[i], grid.r_step)
    np.testing.assert_allclose(rows.lower, 2.0 * distance)


def test_monotone_fit_grows_with_depth():
    options = {"force_weight": 3.0, "torque_weight": 3.0}
    rows = linear(Monotone(SCENE).rows())
    plain = fit(SCENE, "eq10", **options)
    assert (rows.blocks["p"] @ plain.field.values.reshape(-1)).min() < -0.01
    grown = fit(SCENE, "eq10_monotone", **options)
    assert (rows.blocks["p"] @ grown.field.values.reshape(-1)).min() > -1e-5
    assert grown.objective > plain.objective
    assert (grown.duals_by_name["monotone"] <= 1e-9).all()
    assert grown.duals_by_name["monotone"].min() < -1e-6
    steep = fit(SCENE, "eq10_monotone", least_slope=15.0, **options)
    growth = rows.blocks["p"] @ steep.field.values.reshape(-1)
    least = linear(Monotone(SCENE, 15.0).rows()).lower
    assert (growth / least).min() > 0.999


def test_a_slope_that_is_none_is_refused():
    refuses(InputError, "least_slope must not be negative", Monotone, SCENE, -1.0)
