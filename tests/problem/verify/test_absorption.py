"""The bound where other penalties' multipliers absorb r, against known optima."""

import functools
from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp

from tests.kit import small_scene
from tests.solvers.problems import program as bare
from tests.solvers.problems import term
from ttus_opt.problem.formulation import load
from ttus_opt.problem.terms.penalties import Absolute, Groups, Huber, Linear, Penalty
from ttus_opt.problem.verify import absorption
from ttus_opt.problem.verify.kkt import Duals, kkt_residuals
from ttus_opt.solvers.base import Request
from ttus_opt.solvers.registry import solvers

SCENE = small_scene("trilinear", shape=(6, 12, 7), n_poses=6)
PENALTIES = [Absolute(), Groups(3), Huber(0.4)]
each_penalty = pytest.mark.parametrize("phi", PENALTIES, ids=lambda p: p.formula)


def mixed(phi, seed, rank=4):
    """Six penalised rows of a rank, and one square, over four variables."""
    rng = np.random.default_rng(seed)
    M = rng.normal(size=(6, rank)) @ rng.normal(size=(rank, 4))
    own = term(M, rng.normal(size=6), weight=0.3, name="own", penalty=phi)
    return bare([own, term(rng.normal(size=(1, 4)), [5.0], weight=2.0, name="one")])


def optimum(program):
    """By an interior-point method of cvxpy's, from the declaration alone."""
    x = cp.Variable(program.n_variables)
    costs = [
        t.weight * t.penalty.in_cvxpy(t.matrix @ x - t.target, cp)
        for t in program.terms
    ]
    value = cp.Problem(cp.Minimize(sum(costs))).solve(
        solver="CLARABEL", tol_gap_abs=1e-10, tol_gap_rel=1e-10, tol_feas=1e-10
    )
    return np.asarray(x.value), float(value)


def multiplier(program, x):
    """About the optimum's: the subgradient nearest to what squares ask for."""
    own, one = program.terms
    slope = 2.0 * one.weight * (one.matrix.T @ one.residual(x))
    least = np.linalg.lstsq(own.weight * own.matrix.toarray().T, -slope)[0]
    return own.penalty.admissible(least)


@each_penalty
@pytest.mark.parametrize("rank", [4, 3])
def test_no_answer_lies_further_above_the_optimum(phi, rank):
    """Any point with any multipliers; squares alone leave three directions open.

    With three independent rows beside, one direction is known by both together.
    """
    rng = np.random.default_rng(3)
    for seed in range(2):
        program = mixed(phi, seed, rank)
        best, least = optimum(program)
        for size in (0.0, 1e-8, 1e-4, 1e-1, 3.0):
            x = best + size * rng.normal(size=4)
            g = multiplier(program, x) + size * rng.normal(size=6)
            kkt = kkt_residuals(program, x, Duals(terms={"own": g}))
            assert kkt.is_bound
            excess = program.objective(x) - least
            assert excess <= kkt.gap * (1.0 + 1e-9) + 1e-8 * least


@functools.cache
def answer(name):
    program = load(name, SCENE, force_weight=0.1).compile()
    solver = solvers()["augmented_lagrangian"]
    return program, solver.prepare(program, Request(1e-9)).solve()


def residuals(name, factor=1.0):
    """Of the answer, with multipliers that many times as long as they may be."""
    program, found = answer(name)
    terms = {key: factor * g for key, g in found.duals.terms.items()}
    return kkt_residuals(program, found.x, Duals(found.duals.rows, None, terms))


@pytest.mark.parametrize("name", ["total_variation", "sparse_sources"])
def test_a_bound_on_an_exact_answer_is_small(name, monkeypatch):
    """By conjugate gradients with L or a network, and with the diagonal."""
    kkt = residuals(name)
    assert kkt.is_bound
    assert kkt.gap_relative <= 1e-8
    monkeypatch.setattr(absorption._Rows, "_of_field", lambda *_: None)
    assert residuals(name).is_bound


def test_multipliers_that_are_too_long_are_charged_by_how_much():
    """Clipping takes 1e-7 of them and r gets it; apart both are far larger than f."""
    kkt = residuals("sparse_sources", 1.0 + 1e-7)
    assert kkt.is_bound
    assert kkt.gap_relative <= 2e-7


def test_where_there_is_no_bound():
    class Own(Absolute):
        """Does not state its gauge."""

        gauge = Penalty.gauge

    eye, x = np.eye(2), np.array([0.5, 2.0])
    square = term([[1.0, 0.0]], [1.0])
    bounded = bare([square, term(eye, [0.0, 2.0], name="own", penalty=Absolute())])
    assert kkt_residuals(bounded, x, Duals()).is_bound
    unknown = bare([square, term(eye, [0.0, 2.0], name="own", penalty=Own())])
    linear = term([[0.0, 0.0]], [1.0], name="linear", penalty=Linear())
    for program in (unknown, bare([*bounded.terms, linear])):
        assert not kkt_residuals(program, x, Duals(terms={"own": -x})).is_bound


def test_networks_live_as_long_as_their_rows():
    before = len(absorption._networks)
    program = load("total_variation", SCENE).compile()
    terms = (replace(t, matrix=t.matrix.copy()) for t in program.terms)
    program = replace(program, terms=tuple(terms))
    x = np.ones(program.n_variables)
    for _ in range(2):
        kkt_residuals(program, x, Duals())
        assert len(absorption._networks) == before + 1
    del program
    assert len(absorption._networks) == before


def test_the_network_of_one_field_is_not_taken_for_another():
    program = load("total_variation", SCENE).compile()
    own = next(t for t in program.terms if not t.is_squares)
    V = SCENE.n_voxels
    both = replace(own, matrix=sp.csr_array(sp.hstack([own.matrix, 0.0 * own.matrix])))
    given = ~SCENE.laplace.free
    assert absorption._network(both, program, slice(0, V), given) is not None
    assert absorption._network(both, program, slice(V, 2 * V), given) is None


def test_two_points_of_the_same_objective_are_no_further_apart():
    """x₀² + |x₁| at (a, 0) and (−a, 0): 2a apart, P = 2, which is as far as can be."""
    a, theta = 1.5, 0.7
    square = term([[1.0, 0.0]], [0.0])
    size = term([[0.0, 1.0]], [0.0], name="own", penalty=Absolute())
    one, x = bare([square, size]), np.array([a, 0.0])
    made = absorption._Rows(
        one, x, {"own": np.zeros(1)}, [one.terms[1]], np.zeros(1, bool)
    )
    assert made._apart(theta) >= np.sqrt(theta * 2.0) * 2.0 * a
