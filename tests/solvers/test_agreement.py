"""Every backend on every formulation it can take: one answer, verified.

A new solver or formulation is tested here by existing.
"""

from __future__ import annotations

import functools
import warnings

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.problem import formulation as shelf
from ttus_opt.problem.kkt import kkt_residuals
from ttus_opt.problem.reduction import Reduction, reduce
from ttus_opt.scene import Scene
from ttus_opt.solvers.base import Request, Solver
from ttus_opt.solvers.registry import solvers

INSTALLED = [solver for solver in solvers().values() if solver.installed]
FORMULATIONS = [info.name for info in shelf.available()]

#: Asked of every solver
TOLERANCE = 1e-7

#: Half a minute and more
SLOW = {("proxqp", "total_variation")}


@functools.cache
def scene() -> Scene:
    """Three hundred voxels, presses of random size."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return small_scene("trilinear", shape=(5, 10, 6), n_poses=8, seed=4)


@functools.cache
def reduction(formulation: str) -> Reduction:
    """The formulation's program and its reduced form."""
    known = {info.name: info.options for info in shelf.available()}[formulation]
    weights = {k: 0.1 for k in ("force_weight", "torque_weight") if k in known}
    return reduce(shelf.load(formulation, scene(), **weights).compile())


@functools.cache
def best(formulation: str) -> float:
    """The least verified objective over a few solvers of different kinds."""
    found = [
        objective(solvers()[name], formulation)
        for name in ("closed_form", "clarabel", "cvxpy_clarabel")
        if not solvers()[name].refusal(reduction(formulation).program)
    ]
    return min(found)


def objective(solver: Solver, formulation: str) -> float:
    """Objective of a solver's answer, its residuals checked on the original."""
    both = reduction(formulation)
    candidate = solver.prepare(both.program, Request(TOLERANCE, 120.0)).solve()
    assert candidate.x is not None, candidate.detail
    point = both.restore(candidate.x, candidate.duals)
    residuals = kkt_residuals(both.original, point.x, point.duals)
    # restoring multipliers into their set may cost a little of what was reached
    assert residuals.worst_relative <= 10.0 * TOLERANCE, (residuals, candidate.detail)
    return both.original.objective(point.x)


def pairs() -> list[object]:
    """Every solver with every formulation."""
    return [
        pytest.param(
            solver,
            name,
            id=f"{solver.name}-{name}",
            marks=[pytest.mark.slow] if (solver.name, name) in SLOW else [],
        )
        for solver in INSTALLED
        for name in FORMULATIONS
    ]


@pytest.mark.parametrize(("solver", "formulation"), pairs())
def test_objectives_agree(solver: Solver, formulation: str) -> None:
    both = reduction(formulation)
    why = solver.refusal(both.program)
    if why:
        pytest.skip(f"{solver.name} refuses: {why}")
    # the objective of no field at all says what size a difference is compared with
    size = both.original.objective(np.zeros(both.original.n_variables))
    apart = abs(objective(solver, formulation) - best(formulation))
    assert apart <= 1e-5 * abs(size)


def test_every_formulation_has_a_solver() -> None:
    for name in FORMULATIONS:
        takers = [s.name for s in INSTALLED if not s.refusal(reduction(name).program)]
        assert takers, name
