"""How the points of a path are solved: each the minimiser of its own weights."""

import functools

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, refuses, small_scene
from tests.solvers.dual.test_weight_sweep import exact
from tests.solvers.dual.user_limits import contested
from tests.solvers.own_terms import Differences
from ttus_opt.fitting.path import path_solvers
from ttus_opt.fitting.path.path_solvers import point_solver
from ttus_opt.problem.formulation import load
from ttus_opt.solvers.base import Request
from ttus_opt.solvers.dual.weight_sweep import WeightSweep

WEIGHTS = ((1e-3, 1e-2), (1.0, 1e-2), (30.0, 10.0))


@functools.cache
def eq10():
    return load("eq10", small_scene("trilinear", shape=(6, 9, 6), n_poses=6))


@functools.cache
def signed():
    """Reversed forces pull: limits hold at large weights, and do nothing at small."""
    return load("eq10_sign", contested(1, (6, 9, 6), scale=-3.0))


def weighted(declared, force, torque):
    return declared.with_weights(force=force, torque=torque)


def in_basis(declared, request=None):
    found = point_solver(declared, "structured", request or Request(1e-8))
    assert isinstance(found, path_solvers._CommonBasis)
    return found


@pytest.fixture
def singly(monkeypatch):
    """Formulations that were solved by fits of their own."""
    seen = []
    plain = path_solvers._InTurn.__call__

    def counted(self, declared):
        seen.append(declared)
        return plain(self, declared)

    monkeypatch.setattr(path_solvers._InTurn, "__call__", counted)
    return seen


@pytest.fixture
def asked(monkeypatch):
    """Accuracies that the basis was asked for."""
    seen = []
    plain = WeightSweep.solve

    def told(self, root, rtol, *more):
        seen.append(rtol)
        return plain(self, root, rtol, *more)

    monkeypatch.setattr(WeightSweep, "solve", told)
    return seen


@pytest.mark.parametrize("name", ["eq10", "eq10_hard_boundary"])
def test_points_in_a_common_basis_are_the_dense_minimisers(name, singly):
    declared = load(name, eq10().scene)
    solve = in_basis(declared)
    assert solve.common
    for weights in WEIGHTS:
        own = weighted(declared, *weights)
        found = solve(own)
        assert (found.status, found.solver) == (tt.Status.SOLVED, "structured")
        expected = exact(own.compile())
        size = np.abs(expected).max()
        np.testing.assert_allclose(found.candidate, expected, atol=1e-6 * size)
        assert found.field.values.shape == own.scene.voxmap.grid.shape
    assert not singly


def test_where_limits_hold_a_point_is_fitted_alone(singly, asked):
    declared = signed()
    solve = in_basis(declared)
    assert not solve.common
    held = []
    for weight in (1e-6, 100.0):
        own = weighted(declared, weight, weight)
        p = exact(own.compile())
        asked.clear()
        found = solve(own)
        assert found.status is tt.Status.SOLVED
        slack = min(float(s.min()) for s in found.slacks.values())
        assert slack >= -1e-9 * np.abs(p).max()
        held.append(own in singly)
        if held[-1]:
            assert len(asked) == 1  # more accuracy would not make limits hold
            alone = tt.Fitter(own, solver="clarabel").solve()
            assert found.objective == pytest.approx(alone.objective, rel=1e-6)
        else:
            np.testing.assert_allclose(found.candidate, p, atol=1e-6 * np.abs(p).max())
    assert held == [False, True]


def test_a_residual_that_does_not_hold_is_tightened(monkeypatch, asked, singly):
    monkeypatch.setattr(path_solvers, "ENERGY", 1e3)
    own = weighted(eq10(), 1.0, 0.1)
    assert in_basis(own, Request(1e-6))(own).status is tt.Status.SOLVED
    assert asked == pytest.approx([1e-3, 1e-5, 1e-7][: len(asked)])
    assert len(asked) > 1 and not singly


def test_what_the_basis_cannot_reach_is_fitted_alone(monkeypatch, asked, singly):
    monkeypatch.setattr(path_solvers, "ENERGY", 1e12)
    own = weighted(eq10(), 1.0, 0.1)
    assert in_basis(own, Request(1e-6))(own).status is tt.Status.SOLVED
    assert len(asked) == 1 + path_solvers.TIGHTENINGS
    assert singly == [own]


def test_out_of_time_it_says_so(singly):
    own = weighted(eq10(), 1.0, 0.1)
    assert in_basis(own, Request(1e-8, 1e-9))(own).status is tt.Status.TIME_LIMIT
    assert not singly


def test_the_cheapest_way_is_chosen():
    declared, request = weighted(eq10(), 1.0, 1.0), Request()
    ways = {
        "auto": path_solvers._CommonBasis,
        "structured": path_solvers._CommonBasis,
        "closed_form": path_solvers._InTurn,
    }
    for solver, way in ways.items():
        assert type(point_solver(declared, solver, request)) is way
    wide = declared + Differences(declared.scene, 1e-3)
    assert type(point_solver(wide, "auto", request)) is path_solvers._InTurn
    robust = load("robust", declared.scene)
    assert type(point_solver(robust, "auto", request)) is path_solvers._InTurn
    searching = load("coulomb_global", declared.scene)
    assert type(point_solver(searching, "auto", request)) is path_solvers._InTurn
    refuses(InputError, "unknown solver", point_solver, declared, "none", request)


def test_criteria_need_a_basis_without_limits():
    declared = weighted(eq10(), 1.0, 1.0)
    with pytest.raises(InputError, match=r"no criteria for eq10.*without limits"):
        point_solver(declared, "closed_form", Request()).prepare_criteria(declared)
    with pytest.raises(InputError, match=r"no criteria for eq10_sign.*without limits"):
        in_basis(signed()).prepare_criteria(signed())
    solve = in_basis(declared)
    assert solve.criteria(declared) == {}  # before they are prepared
    solve.prepare_criteria(declared)
    assert solve.criteria(declared)
    assert point_solver(declared, "closed_form", Request()).criteria(declared) == {}


def test_only_one_field_and_few_rows_suit():
    scene = small_scene("trilinear")
    for name in ("tikhonov", "viscous_drag", "coulomb_drag"):
        assert not path_solvers._suits_sweep(load(name, scene).compile()), name


def test_limits_are_told_from_boundary_values():
    hard, sign = (
        load("eq10_hard_boundary", small_scene("trilinear")),
        load("eq10_sign_monotone", small_scene("trilinear")),
    )
    assert not path_solvers._is_limited(hard.compile()) and path_solvers._is_limited(
        sign.compile()
    )
    program = sign.compile()
    inside = program.laplace.solve(sign.scene.b)
    assert path_solvers._keeps_limits(program, inside)
    deep = int(np.argmax(inside * program.laplace.free))
    for broken in (-inside, np.where(np.arange(len(inside)) == deep, 0.0, inside)):
        for unit in (1.0, 1e-12):  # rounding is that of the values
            assert not path_solvers._keeps_limits(program, unit * broken)
