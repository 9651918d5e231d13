"""Re-solving: ``update`` gives what a fresh ``prepare`` gives and keeps its factor."""

from dataclasses import replace

import numpy as np
import pytest

from tests.kit import small_scene, with_wrenches
from tests.solvers import taking
from ttus_opt.problem.constraints.signs import Sign
from ttus_opt.problem.formulation import load
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers.base import Request
from ttus_opt.solvers.registry import solvers

#: Who keeps something; highs keeps nothing, and each solve takes it seconds
KEEPERS = {
    "free": taking.FORMULATIONS["eq10"],
    "signed": taking.FORMULATIONS["eq10_sign"] - taking.HIGHS,
}
SHAPE = (5, 8, 5)


def compiled(signed, factor=1.0, weight=1.0):
    """Eq. 10 with all measured forces scaled and another weight."""
    scene = small_scene("trilinear", shape=SHAPE, n_poses=8, seed=3)
    scene = with_wrenches(scene, factor * scene.f)
    declared = load("eq10", scene, force_weight=weight, torque_weight=1.0)
    if signed:
        declared = declared.with_constraints(Sign(scene))
    return declared.compile()


@pytest.mark.parametrize(("solver", "limits"), taking.pairs(KEEPERS))
def test_update_equals_fresh(solver, limits):
    signed = limits == "signed"
    first = compiled(signed)
    tolerance = 1e-8
    prepared = solver.prepare(first, Request(tolerance, 60.0))
    prepared.solve()
    for changed in (
        compiled(signed, factor=1.1),  # new measured values
        compiled(signed, factor=1.1, weight=3.0),  # a new weight
        compiled(signed),  # and back
    ):
        prepared.update(changed)
        again = prepared.solve()
        fresh = solver.prepare(changed, Request(tolerance, 60.0)).solve()
        residuals = kkt_residuals(changed, again.x, again.duals)
        assert residuals.worst_relative <= tolerance
        apart = np.linalg.norm(again.x - fresh.x) / np.linalg.norm(fresh.x)
        assert apart <= 1e-4


@taking.over({"osqp", "scs"})
def test_splitting_starts_from_its_last_answer(solver):
    prepared = solver.prepare(compiled(True, factor=-2.0), Request(1e-7))
    cold = prepared.solve().iterations
    prepared.update(compiled(True, factor=-2.0001))
    assert prepared.solve().iterations < cold


def test_amg_pcg_keeps_its_multigrid_and_starts_from_its_last_answer(monkeypatch):
    solver = solvers()["amg_pcg"]
    import pyamg

    made = []
    original = pyamg.ruge_stuben_solver

    def counting(A):
        made.append(A)
        return original(A)

    monkeypatch.setattr(pyamg, "ruge_stuben_solver", counting)
    program = compiled(False)
    prepared = solver.prepare(program, Request(1e-8))
    cold = prepared.solve().iterations
    own = {"force": 1.001}
    terms = (t.with_weight(own.get(t.name, t.weight)) for t in program.terms)
    prepared.update(replace(program, terms=tuple(terms)))
    assert prepared.solve().iterations < cold
    assert len(made) == 1
