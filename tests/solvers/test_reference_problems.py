"""Known primal and dual answers for every installed solver, one tolerance table."""

import numpy as np
import pytest

from tests.solvers import taking
from tests.solvers.problems import (
    bending_references,
    bounds,
    program,
    references,
    rows,
    term,
)
from ttus_opt.problem.reduction import reduce
from ttus_opt.problem.terms.penalties import Linear
from ttus_opt.problem.verify.kkt import Duals, kkt_residuals
from ttus_opt.solvers.base import Claim, Request

#: Relative KKT residual asked for, and the largest error of x and of the duals that
#: may come with it; one line for all, exceptions by name
TOLERANCE = 1e-8
LARGEST_ERROR = {"default": 1e-6}

#: Who says "infeasible" and "unbounded" in so many words; the others give up, and
#: nobody says "done"
KNOWS_INFEASIBLE = {"clarabel", "cvxpy_clarabel", "cvxpy_scs", "osqp", "scs"}


REFERENCES = {reference.name: reference for reference in references()}
BENDING = {reference.name: reference for reference in bending_references()}


def pairs(problems):
    return taking.pairs({name: taking.REFERENCES[name] for name in problems})


def error_of(got, expected):
    return float(np.abs(np.asarray(got) - np.asarray(expected, dtype=float)).max())


def check(solver, reference):
    reduction = reduce(reference.program)
    taken = reference.program if solver.capabilities.nonquadratic else reduction.program
    candidate = solver.prepare(taken, Request(TOLERANCE, 60.0)).solve()
    assert candidate.claim is Claim.DONE, candidate.detail
    x, duals = candidate.x, candidate.duals
    if taken is not reference.program:
        point = reduction.restore(x, duals)
        x, duals = point.x, point.duals
    largest = LARGEST_ERROR.get(solver.name, LARGEST_ERROR["default"])
    if reference.weak:
        largest = max(largest, np.sqrt(TOLERANCE))
    assert error_of(x, reference.x) <= largest
    for name, expected in reference.rows.items():
        assert error_of(duals.rows[name], expected) <= largest, name
    if reference.bounds is not None:
        assert error_of(duals.bounds, reference.bounds) <= largest
    for name, expected in reference.terms.items():
        bent = reference.program.term(name)
        # Huber's is a function of x: a solver need not return it
        got = duals.terms.get(name, bent.penalty.subgradient(bent.residual(x)))
        assert error_of(got, expected) <= largest, name
    # where the objective is zero too, its distance from zero is open to √ε as x is
    ours = np.sqrt(TOLERANCE) if reference.weak else TOLERANCE
    assert kkt_residuals(reference.program, x, duals).worst_relative <= ours


@pytest.mark.parametrize(("solver", "name"), pairs(REFERENCES))
def test_answer_is_the_known_one(solver, name):
    check(solver, REFERENCES[name])


@pytest.mark.parametrize(("solver", "name"), pairs(BENDING))
def test_bending_penalties(solver, name):
    check(solver, BENDING[name])


def test_references_hold_without_any_solver():
    for ref in references() + bending_references():
        duals = Duals(
            {k: np.asarray(v, dtype=float) for k, v in ref.rows.items()},
            None if ref.bounds is None else np.asarray(ref.bounds, dtype=float),
            {k: np.asarray(v, dtype=float) for k, v in ref.terms.items()},
        )
        x = np.asarray(ref.x, dtype=float)
        assert kkt_residuals(ref.program, x, duals).worst_relative < 1e-12, ref.name


@taking.over(taking.BOUNDED)
def test_contradiction_is_never_called_done(solver):
    contradiction = program(
        [term(np.eye(2), [0, 0])],
        [rows("high", [[1, 1]], [3], [np.inf])],
        [bounds("low", [-1, -1], [1, 1])],
    )
    request = Request(TOLERANCE, 10.0)
    candidate = solver.prepare(contradiction, request).solve()
    if solver.name in KNOWS_INFEASIBLE:
        assert candidate.claim is Claim.INFEASIBLE, candidate.detail
    if candidate.x is not None:
        residuals = kkt_residuals(contradiction, candidate.x, candidate.duals)
        assert residuals.worst_relative > 1e-3


@taking.over(taking.BOUNDED)
def test_no_minimum_is_never_called_done(solver):
    downhill = program(
        [term([[1, 0]], [0]), term([[0, 1]], [0], 1.0, Linear(), name="downhill")],
        (),
        [bounds("half", [-1, -np.inf], [1, 3])],
    )
    candidate = solver.prepare(downhill, Request(TOLERANCE, 10.0)).solve()
    if candidate.x is not None:
        residuals = kkt_residuals(downhill, candidate.x, candidate.duals)
        assert residuals.worst_relative > TOLERANCE
    assert candidate.claim is not Claim.DONE or candidate.x is not None
