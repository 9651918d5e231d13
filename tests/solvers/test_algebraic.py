"""Sums of squares without a Laplace term against a direct factorisation."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.sparse as sp

import ttus_opt as tt
from tests.kit import MissingPackageError, small_scene
from tests.oracles.dense import minimiser
from tests.solvers.own_terms import Differences, SkinGraph
from ttus_opt.problem.terms.departures import difference_rows
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers.base import Claim, Request
from ttus_opt.solvers.primal import sparse_inverse
from ttus_opt.solvers.primal.sparse_inverse import Estimate, SparseInverse
from ttus_opt.solvers.proximal import field_newton
from ttus_opt.solvers.registry import solvers

SCENE, SOLVER = small_scene("trilinear", (6, 12, 7)), solvers()["algebraic"]


@dataclass(frozen=True)
class Ridge(tt.Term):
    """Squares of the departure from the Laplace field."""

    name = "ridge"

    def rows(self):
        one = sp.eye_array(self.scene.n_voxels, format="csr")
        return tt.AffineRows({"p": one}, self.scene.laplace.solve(self.scene.b))


@dataclass(frozen=True)
class GraphLaplacian(tt.Term):
    """Squares of the grid's graph Laplacian."""

    name = "graph_laplacian"

    def rows(self):
        D = difference_rows(self.scene.voxmap.grid)
        return tt.AffineRows({"p": sp.csr_array(D.T @ D)}, np.zeros(D.shape[1]))


def declared(scene, case, weight=1e-2):
    measured = [ForceTerm(scene, weight), TorqueTerm(scene, 0.5 * weight)]
    held = [tt.constraints.HardBoundary(scene)]
    prior = {
        "differences": ([Differences(scene)], held),
        "ridge": ([Ridge(scene)], []),
        "graph": ([GraphLaplacian(scene)], held),
        "sum": ([Ridge(scene, 0.1), SkinGraph(scene, 3.0)], []),
    }
    terms, constraints = prior[case]
    return tt.Formulation([*terms, *measured], constraints)


def solved(program, tolerance=1e-9):
    return SOLVER.prepare(program, Request(tolerance)).solve()


@pytest.fixture(params=["a factor", "algebraic multigrid"])
def way(request, monkeypatch):
    """Either way, whatever the estimate says."""
    chosen = request.param == "a factor"
    monkeypatch.setattr(Estimate, "by_factor", property(lambda self: chosen))
    return str(request.param)


@pytest.mark.parametrize("weight", [1e-4, 1e2])
def test_differences_between_given_values_are_a_network(weight, monkeypatch):
    monkeypatch.setattr(field_newton, "NETWORK", 0)
    program = declared(SCENE, "differences", weight).compile()
    found = solved(program)
    assert found.detail.startswith("the grid's multigrid")
    assert found.iterations < 60
    expected = minimiser(program)
    apart = np.linalg.norm(found.x - expected) / np.linalg.norm(expected)
    assert apart <= 1e-7
    soft = tt.Formulation([Differences(SCENE), Ridge(SCENE, 0.1)]).compile()
    beside = solved(soft)  # its boundary values move: not of the grid's free voxels
    assert not beside.detail.startswith("the grid's multigrid")


@pytest.mark.parametrize("case", ["differences", "ridge", "graph", "sum"])
def test_equals_a_factorisation(case, way):
    for weight in (1e-4, 1e2):
        program = declared(SCENE, case, weight).compile()
        found = solved(program)
        assert found.x is not None and found.detail.startswith(way)
        expected = minimiser(program)
        apart = np.linalg.norm(found.x - expected) / np.linalg.norm(expected)
        assert apart < 1e-6
        residuals = kkt_residuals(program, found.x, found.duals)
        assert residuals.worst_relative < 1e-8


def test_auto_takes_it_and_its_answer_is_verified():
    solution = tt.fit(SCENE, declared(SCENE, "differences"))
    assert solution.status is tt.Status.SOLVED
    large = replace(tt.Formulation([Ridge(SCENE)]).compile())
    assert SOLVER.cost(large) < np.inf


def test_new_targets_keep_what_was_set_up(monkeypatch):
    program = declared(SCENE, "ridge").compile()
    prepared = SOLVER.prepare(program, Request(1e-9))
    prepared.solve()
    monkeypatch.setattr(SparseInverse, "of", None)  # would be called to set up anew
    terms = tuple(replace(t, target=2.0 * t.target) for t in program.terms)
    other = replace(program, terms=terms)
    prepared.update(other)
    again = prepared.solve()
    expected = minimiser(other)
    apart = np.linalg.norm(again.x - expected) / np.linalg.norm(expected)
    assert apart < 1e-6


def test_what_no_square_determines_stays_where_it_is():
    """Voxels that nothing touches do not move, and nothing fails for them."""
    program = tt.Formulation([ForceTerm(SCENE, 1.0)]).compile()
    found = solved(program, 1e-6)
    untouched = np.diff(sp.csc_array(program.terms[0].matrix).indptr) == 0
    assert untouched.any() and (found.x[untouched] == 0.0).all()


def test_a_missing_package_is_told_and_another_solver_goes_on(monkeypatch):
    def missing(module, extra):
        raise MissingPackageError(f'{module}: pip install "ttus-opt[{extra}]"')

    monkeypatch.setattr(Estimate, "by_factor", property(lambda self: False))
    monkeypatch.setattr(sparse_inverse, "load", missing)
    program = declared(SCENE, "ridge").compile()
    found = solved(program)
    assert found.x is None and found.claim is Claim.GAVE_UP
    assert found.detail == 'pyamg: pip install "ttus-opt[reference]"'


def test_refuses_what_others_know_more_of():
    laplace = tt.Formulation([tt.terms.LaplaceTerm(SCENE), Ridge(SCENE)]).compile()
    assert "normal_equations" in SOLVER.refusal(laplace)
    limited = tt.Formulation([Ridge(SCENE)], [tt.constraints.Sign(SCENE)]).compile()
    assert SOLVER.refusal(limited)
