"""Each constraint against plain loops, and what it does to a field."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.constraints.base import Bounds, LinearRows
from ttus_opt.constraints.boundary import HardBoundary
from ttus_opt.constraints.drag_limit import DragLimit
from ttus_opt.constraints.drag_sign import DragSign
from ttus_opt.constraints.mean_friction import MeanFriction
from ttus_opt.constraints.monotone import Monotone
from ttus_opt.constraints.nonnegative import NonNegative
from ttus_opt.constraints.sign import Sign
from ttus_opt.constraints.viscous_sign import ViscousSign
from ttus_opt.errors import InputError
from ttus_opt.fitting.batch import fit
from ttus_opt.voxmap.voxmap import INSIDE, OUTSIDE, SURFACE

SCENE = small_scene("trilinear", n_poses=30)
REGION = SCENE.voxmap.region


def linear(rows: LinearRows | Bounds) -> LinearRows:
    assert isinstance(rows, LinearRows)
    return rows


def bounds(rows: LinearRows | Bounds) -> Bounds:
    assert isinstance(rows, Bounds)
    return rows


def test_monotone_rows_are_the_pairs_of_each_spoke() -> None:
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


def test_monotone_fit_grows_with_depth() -> None:
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


def test_sign_fit_has_the_sign() -> None:
    options = {"force_weight": 3.0, "torque_weight": 3.0}
    plain = fit(SCENE, "eq10", **options).field.values
    assert plain[REGION == INSIDE].min() < -1e-3
    signed = fit(SCENE, "eq10_sign", **options)
    p = signed.field.values
    assert p[REGION == INSIDE].min() > -1e-6
    assert p[REGION == OUTSIDE].max() < 1e-6
    assert signed.slacks["sign"].min() > -1e-6
    dual = signed.duals_by_name["sign"]
    assert dual.shape == (SCENE.n_voxels,)
    # a lower limit holds with a negative multiplier, and only where it is met
    assert dual.min() < -1e-6
    assert np.abs(
        dual * np.where(np.isfinite(p.reshape(-1)), p.reshape(-1), 0)
    ).max() < (1e-4)
    both = fit(SCENE, "eq10_sign_monotone", **options)
    assert both.objective >= signed.objective - 1e-9
    assert set(both.duals_by_name) == {"sign", "monotone"}


def test_hard_boundary_keeps_the_values() -> None:
    rows = linear(HardBoundary(SCENE).rows())
    np.testing.assert_array_equal(rows.lower, rows.upper)
    hard = fit(SCENE, "eq10_hard_boundary", force_weight=3.0)
    fixed = SCENE.voxmap.dirichlet
    np.testing.assert_allclose(
        hard.field.values[fixed], SCENE.b.reshape(REGION.shape)[fixed], atol=1e-9
    )
    soft = fit(SCENE, "eq10", force_weight=3.0)
    assert hard.objective > soft.objective


def test_bounds_by_region() -> None:
    flat = REGION.reshape(-1)
    sign, touch = bounds(Sign(SCENE).rows()), bounds(NonNegative(SCENE).rows())
    np.testing.assert_array_equal(np.isfinite(sign.lower), flat == INSIDE)
    np.testing.assert_array_equal(np.isfinite(sign.upper), flat == OUTSIDE)
    np.testing.assert_array_equal(np.isfinite(touch.lower), flat != OUTSIDE)
    assert not np.isfinite(touch.upper).any()
    drag = bounds(DragSign(SCENE).rows())
    assert drag.variable == "q"
    np.testing.assert_array_equal(drag.upper == 0.0, flat != INSIDE)
    np.testing.assert_array_equal(drag.lower == 0.0, flat != OUTSIDE)
    viscous = bounds(ViscousSign(SCENE, 6).rows())
    assert (viscous.variable, len(viscous.lower)) == ("c", 6)
    mean = bounds(MeanFriction(SCENE, 0.4).rows())
    assert (mean.variable, mean.lower, mean.upper) == ("m", [0.0], [0.4])


def test_drag_limit_is_a_share_of_the_field() -> None:
    rows = linear(DragLimit(SCENE, 0.4).rows())
    p, q = np.random.default_rng(0).normal(size=(2, SCENE.n_voxels))
    value = rows.blocks["p"] @ p + rows.blocks["q"] @ q
    beside = REGION.reshape(-1) != 0
    np.testing.assert_allclose(value, 0.4 * p[beside] - q[beside])
    inside = REGION.reshape(-1)[beside] > 0
    np.testing.assert_array_equal(rows.lower == 0.0, inside)
    np.testing.assert_array_equal(rows.upper == 0.0, ~inside)


def test_numbers_that_are_none() -> None:
    with pytest.raises(InputError, match="least_slope must not be negative"):
        Monotone(SCENE, -1.0)
    with pytest.raises(InputError, match="largest friction must lie between"):
        DragLimit(SCENE, 0.0)
    with pytest.raises(InputError, match="largest friction must lie between"):
        MeanFriction(SCENE, -1.0)
