"""Every backend on every formulation it can take: one answer, verified.

Which that are is written in `taking`; a new solver or formulation fails there until it
is, and is tested here.
"""

import functools
import warnings

import numpy as np
import pytest

from tests.kit import small_scene
from tests.solvers import taking
from ttus_opt.problem.formulation import available, load
from ttus_opt.problem.reduction import reduce
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers.base import Request
from ttus_opt.solvers.registry import solvers

#: Asked of every solver
TOLERANCE = 1e-7

#: Five seconds and more
SLOW = {
    ("proxqp", "total_variation"),
    ("scs", "sparse_sources"),
    ("cvxpy_scs", "total_variation"),
}


@functools.cache
def scene():
    """Two hundred voxels, presses of random size."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return small_scene("trilinear", shape=(5, 8, 5), n_poses=8, seed=4)


@functools.cache
def reduction(formulation):
    """The formulation's program and its reduced form."""
    known = {info.name: info.options for info in available()}[formulation]
    weights = {k: 0.1 for k in ("force_weight", "torque_weight") if k in known}
    return reduce(load(formulation, scene(), **weights).compile())


@functools.cache
def best(formulation):
    """The least verified objective over a few solvers of different kinds."""
    found = [
        objective(solvers()[name], formulation)
        for name in ("closed_form", "clarabel", "cvxpy_clarabel")
        if name in taking.FORMULATIONS[formulation]
    ]
    return min(found)


def objective(solver, formulation):
    """Objective of a solver's answer, its residuals checked on the original."""
    both = reduction(formulation)
    candidate = solver.prepare(both.program, Request(TOLERANCE, 120.0)).solve()
    assert candidate.x is not None, candidate.detail
    point = both.restore(candidate.x, candidate.duals)
    residuals = kkt_residuals(both.original, point.x, point.duals)
    # restoring multipliers into their set may cost a little of what was reached
    assert residuals.worst_relative <= 10.0 * TOLERANCE, (residuals, candidate.detail)
    return both.original.objective(point.x)


@pytest.mark.parametrize(
    ("solver", "formulation"), taking.pairs(taking.FORMULATIONS, SLOW)
)
def test_objectives_agree(solver, formulation):
    both = reduction(formulation)
    # the objective of no field at all says what size a difference is compared with
    size = both.original.objective(np.zeros(both.original.n_variables))
    apart = abs(objective(solver, formulation) - best(formulation))
    assert apart <= 1e-5 * abs(size)


@pytest.mark.parametrize("name", taking.FORMULATIONS)
def test_every_formulation_has_a_solver(name):
    assert taking.installed(taking.FORMULATIONS[name])
