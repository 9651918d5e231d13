"""Huber's and absolute penalties as quadratic programs: same minimum, duals back."""

import numpy as np
import pytest

from tests.kit import small_scene
from ttus_opt.problem.constraints.boundary import HardBoundary
from ttus_opt.problem.constraints.signs import Sign
from ttus_opt.problem.program import Program
from ttus_opt.problem.reduction import reduce
from ttus_opt.problem.terms.departures import TotalVariationTerm
from ttus_opt.problem.terms.laplace import LaplaceTerm, SparseSourcesTerm
from ttus_opt.problem.terms.penalties import Absolute
from ttus_opt.problem.terms.wrench import RobustForceTerm
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers import registry
from ttus_opt.solvers.base import Request

SCENE = small_scene("trilinear", shape=(7, 12, 8), n_poses=6)


def bent():
    terms = [
        LaplaceTerm(SCENE),
        RobustForceTerm(SCENE, 0.1, 0.3),
        SparseSourcesTerm(SCENE, 0.01),
    ]
    return Program.build(SCENE, terms, [HardBoundary(SCENE), Sign(SCENE)])


def test_a_quadratic_program_is_left_alone():
    program = Program.build(SCENE, [LaplaceTerm(SCENE)], [Sign(SCENE)])
    assert reduce(program).program is program
    cones = Program.build(SCENE, [TotalVariationTerm(SCENE, isotropic=True)], [])
    assert reduce(cones).program is cones


def test_the_best_auxiliary_variables_give_the_original_objective():
    program = bent()
    reduced = reduce(program).program
    rng = np.random.default_rng(0)
    for _ in range(3):
        p = rng.normal(size=SCENE.n_voxels)
        x = np.zeros(reduced.n_variables)
        x[: len(p)] = p
        for term in program.terms[1:]:
            r = term.residual(p)
            excess = (
                r if isinstance(term.penalty, Absolute) else r - np.clip(r, -0.3, 0.3)
            )
            x[reduced.variables[f"{term.name}:above"]] = np.maximum(excess, 0.0)
            x[reduced.variables[f"{term.name}:below"]] = np.maximum(-excess, 0.0)
        split = reduced.constraints[1]
        assert np.abs(split.slack(x)).max() < 1e-12
        assert all(b.slack(x).min() >= 0.0 for b in reduced.bounds[1:])
        assert reduced.objective(x) == pytest.approx(program.objective(p))


def test_lifting_undoes_restoring_and_keeps_optimality():
    both = reduce(bent())
    backend = registry.solvers()["clarabel"]
    found = backend.prepare(both.program, Request(1e-9)).solve()
    point = both.restore(found.x, found.duals)
    lifted = both.lift(point.x, point.duals)
    again = both.restore(lifted.x, lifted.duals)
    np.testing.assert_array_equal(again.x, point.x)
    for name, g in point.duals.terms.items():
        np.testing.assert_allclose(again.duals.terms[name], g, rtol=1e-12)
    kkt = kkt_residuals(both.program, lifted.x, lifted.duals)
    assert kkt.worst_relative < 1e-6
    assert both.program.declared is both.original
