"""Sparse sources: the active set by brute force; fields over decades of weights."""

import itertools

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import NumericalError, refuses, small_scene
from ttus_opt.problem.program import Program
from ttus_opt.problem.reduction import reduce
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers import registry
from ttus_opt.solvers.base import Request
from ttus_opt.solvers.proximal import source_exchange
from ttus_opt.solvers.proximal.source_exchange import nonnegative_minimum

SCENE = small_scene("trilinear", shape=(6, 12, 7), n_poses=8, seed=4)


@pytest.mark.parametrize("seed", range(2))
def test_the_active_set_finds_the_best_of_all_sets(seed):
    rng = np.random.default_rng(seed)
    A, target, charge = rng.normal(size=(7, 6)), rng.normal(size=7), rng.uniform(size=6)
    G, g = A.T @ A, A.T @ target - charge

    def value(x):
        return float(0.5 * x @ G @ x - g @ x)

    best = 0.0
    for size in range(1, 7):
        for chosen in itertools.combinations(range(6), size):
            x = np.zeros(6)
            at = list(chosen)
            x[at] = np.linalg.solve(G[np.ix_(at, at)], g[at])
            if (x >= 0.0).all():
                best = min(best, value(x))
    found = nonnegative_minimum(A, target, charge)
    assert (found >= 0.0).all()
    assert value(found) == pytest.approx(best, rel=1e-10)


def test_an_active_set_that_does_not_settle_is_told(monkeypatch):
    def unsettled(*_, **limits):
        raise RuntimeError("Maximum number of iterations reached.")

    monkeypatch.setattr(source_exchange, "nnls", unsettled)
    given = np.eye(2), np.ones(2), np.zeros(2)
    refuses(NumericalError, "did not settle", nonnegative_minimum, *given)


@pytest.mark.parametrize("weight", [1e-8, 1e-6, 1e-4, 1e-2])
def test_sources_are_exact_over_six_decades(weight):
    terms = [tt.terms.SparseSourcesTerm(SCENE, weight), tt.terms.ForceTerm(SCENE, 1e-2)]
    what = Program.build(SCENE, terms, [tt.constraints.HardBoundary(SCENE)])
    both = reduce(what)
    solver = registry.solvers()["augmented_lagrangian"]
    found = solver.prepare(both.program, Request(1e-6)).solve()
    point = both.restore(found.x, found.duals)
    assert kkt_residuals(what, point.x, point.duals).worst_relative <= 1e-6
    assert "sources" in found.detail
