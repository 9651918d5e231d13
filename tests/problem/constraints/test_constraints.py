"""The shelf of constraints, and what it takes."""

import itertools
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from tests.kit import InputError, refuses, small_scene
from ttus_opt.fitting.batch import fit
from ttus_opt.problem.constraints import signs
from ttus_opt.problem.constraints.base import Bounds, ConeRows, Constraint, LinearRows
from ttus_opt.problem.constraints.boundary import HardBoundary
from ttus_opt.problem.constraints.monotone import Monotone
from ttus_opt.voxmap.voxmap import INSIDE, OUTSIDE, SURFACE

FEW = small_scene(shape=(5, 8, 6), n_poses=5)
V = FEW.n_voxels
ROWS = sp.csr_array(np.eye(6, V))


@dataclass(frozen=True)
class Own(Constraint):
    """Whatever is given."""

    given: Any = field(default=None, repr=False)
    name = "own"

    def rows(self):
        return self.given


def test_linear_rows_come_in_one_format_and_keep_their_meaning():
    given = LinearRows({"p": sp.coo_array(ROWS), "m": ROWS[:, :1]}, [0] * 6, [1] * 6)
    found = Own(FEW, given).assembled
    assert isinstance(found, LinearRows)
    assert all(isinstance(M, sp.csr_array) for M in found.blocks.values())
    np.testing.assert_array_equal(found.blocks["p"].toarray(), np.eye(6, V))
    assert found.lower.dtype == found.upper.dtype == np.float64
    np.testing.assert_array_equal(found.upper, np.ones(6))


def test_cones_take_all_rows():
    whole = Own(FEW, ConeRows({"p": ROWS}, np.zeros(6), (4, 2))).assembled
    assert isinstance(whole, ConeRows) and whole.sizes == (4, 2)
    for sizes in ((4, 1), (4, 3), (6, 0), (7, -1)):
        own = Own(FEW, ConeRows({"p": ROWS}, np.zeros(6), sizes))
        refuses(InputError, "one cone after the other", getattr, own, "assembled")


@pytest.mark.parametrize(
    ("lower", "upper", "told"),
    [
        (np.inf, np.inf, "6 lower limits are infinite on the wrong side"),
        (-np.inf, -np.inf, "6 upper limits are infinite on the wrong side"),
    ],
)
@pytest.mark.parametrize("kind", ["rows", "bounds"])
def test_limits_that_nothing_obeys_are_refused(kind, lower, upper, told):
    low, high = np.full(6, lower), np.full(6, upper)
    given = LinearRows({"p": ROWS}, low, high) if kind == "rows" else None
    limits = Own(FEW, given or Bounds("m", low, high))
    refuses(InputError, told, lambda: limits.assembled)


def test_limits_of_different_lengths_are_refused():
    rows = Own(FEW, LinearRows({"p": ROWS}, np.zeros(6), np.ones(5)))
    refuses(InputError, "6 lower limits and 5 upper ones", lambda: rows.assembled)


SCENE = small_scene("trilinear", n_poses=30)
REGION = SCENE.voxmap.region
FLAT = REGION.reshape(-1)
WEIGHTS = {"force_weight": 3.0, "torque_weight": 3.0}


@pytest.mark.parametrize(
    ("constraint", "variable", "above_zero", "below_zero"),
    [
        (signs.Sign(SCENE), "p", FLAT == INSIDE, FLAT == OUTSIDE),
        (signs.DragSign(SCENE), "q", FLAT != OUTSIDE, FLAT != INSIDE),
        (signs.NonNegative(SCENE), "p", FLAT != OUTSIDE, np.zeros_like(FLAT, bool)),
        (signs.ViscousSign(SCENE, 6), "c", np.ones(6, bool), np.zeros(6, bool)),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_signs_are_bounds_at_zero(constraint, variable, above_zero, below_zero):
    rows = constraint.rows()
    assert rows.variable == variable
    np.testing.assert_array_equal(rows.lower, np.where(above_zero, 0.0, -np.inf))
    np.testing.assert_array_equal(rows.upper, np.where(below_zero, 0.0, np.inf))


def test_the_mean_lies_between_nothing_and_the_largest():
    mean = signs.MeanFriction(SCENE, 0.4).rows()
    assert (mean.variable, mean.lower, mean.upper) == ("m", [0.0], [0.4])


@pytest.mark.parametrize(
    ("kind", "value", "words"),
    [
        (signs.DragLimit, 0.0, "largest friction must lie between"),
        (signs.MeanFriction, -1.0, "largest friction must lie between"),
        (Monotone, -1.0, "least_slope must not be negative"),
    ],
)
def test_a_limit_that_is_none_is_refused(kind, value, words):
    refuses(InputError, words, kind, SCENE, value)


def test_hard_boundary_keeps_the_values():
    rows = HardBoundary(SCENE).rows()
    np.testing.assert_array_equal(rows.lower, rows.upper)
    hard = fit(SCENE, "eq10_hard_boundary", force_weight=3.0)
    fixed = SCENE.voxmap.dirichlet
    np.testing.assert_allclose(
        hard.field.values[fixed], SCENE.b.reshape(REGION.shape)[fixed], atol=1e-9
    )
    soft = fit(SCENE, "eq10", force_weight=3.0)
    assert hard.objective > soft.objective


def test_drag_limit_is_a_share_of_the_field():
    rows = signs.DragLimit(SCENE, 0.4).rows()
    p, q = np.random.default_rng(0).normal(size=(2, SCENE.n_voxels))
    value = rows.blocks["p"] @ p + rows.blocks["q"] @ q
    beside = FLAT != 0
    np.testing.assert_allclose(value, 0.4 * p[beside] - q[beside])
    inside = FLAT[beside] > 0
    np.testing.assert_array_equal(rows.lower == 0.0, inside)
    np.testing.assert_array_equal(rows.upper == 0.0, ~inside)


def test_sign_fit_has_the_sign():
    plain = fit(SCENE, "eq10", **WEIGHTS).field.values
    assert plain[REGION == INSIDE].min() < -1e-3
    signed = fit(SCENE, "eq10_sign", **WEIGHTS)
    p = signed.field.values
    assert p[REGION == INSIDE].min() > -1e-6
    assert p[REGION == OUTSIDE].max() < 1e-6
    assert signed.slacks["sign"].min() > -1e-6
    dual = signed.duals_by_name["sign"]
    assert dual.shape == (SCENE.n_voxels,)
    # a lower limit holds with a negative multiplier, and only where it is met
    assert dual.min() < -1e-6
    assert np.abs(dual * p.reshape(-1)).max() < 1e-4
    both = fit(SCENE, "eq10_sign_monotone", **WEIGHTS)
    assert both.objective >= signed.objective - 1e-9
    assert set(both.duals_by_name) == {"sign", "monotone"}


def test_monotone_rows_are_the_pairs_of_each_spoke():
    rows = Monotone(SCENE, 2.0).rows()
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
    rows = Monotone(SCENE).rows()
    plain = fit(SCENE, "eq10", **WEIGHTS)
    assert (rows.blocks["p"] @ plain.field.values.reshape(-1)).min() < -0.01
    grown = fit(SCENE, "eq10_monotone", **WEIGHTS)
    assert (rows.blocks["p"] @ grown.field.values.reshape(-1)).min() > -1e-5
    assert grown.objective > plain.objective
    assert (grown.duals_by_name["monotone"] <= 1e-9).all()
    assert grown.duals_by_name["monotone"].min() < -1e-6
    steep = fit(SCENE, "eq10_monotone", least_slope=15.0, **WEIGHTS)
    growth = rows.blocks["p"] @ steep.field.values.reshape(-1)
    least = Monotone(SCENE, 15.0).rows().lower
    assert (growth / least).min() > 0.999
