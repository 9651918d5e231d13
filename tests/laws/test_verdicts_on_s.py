"""The law of the verdict at full size: case S, every formulation of the shelf.

What is called SOLVED has the optimum's objective and parameters: of answers perturbed a
little and much, and of solvers that are stopped before they are done.
"""

import functools

import numpy as np
import pytest

from tests.laws.test_verdicts import (
    NAMES,
    TOLERANCE,
    assert_law,
    exact,
    judge,
    perturbations,
)
from ttus_opt.benchmark.cases import reference_cases
from ttus_opt.fitting.batch import Fitter
from ttus_opt.problem.solution import Status
from ttus_opt.solvers import registry
from ttus_opt.solvers.base import Request

pytestmark = [pytest.mark.slow, pytest.mark.long]

#: Solvers that fits on S take, beside those for small grids
SOLVERS = ("structured", "normal_equations", "augmented_lagrangian", "covariance")

#: Parts of the time a solver takes after which it is stopped
EARLY = (0.2, 0.6)


@functools.cache
def case_s():
    return reference_cases("S")[0].scene()


def answer(name):
    return exact(name, 1e-2, case_s, 1e-8)


@pytest.mark.parametrize("name", NAMES)
def test_a_perturbed_answer_on_s(name):
    known, rng = answer(name), np.random.default_rng(7)
    assert judge(known, known.candidate.x).status is Status.SOLVED
    refused = 0
    for what, direction in perturbations(known, rng):
        size = 10.0 ** rng.uniform(-6.0, 0.0)
        found = judge(known, known.candidate.x + size * direction)
        assert_law(found, known.solution, f"{what} by {size:.1e}")
        refused += found.status is not Status.SOLVED
    assert refused > 0


@pytest.mark.parametrize("name", NAMES)
def test_solvers_stopped_early_on_s(name):
    known, ran = answer(name), 0
    for solver in SOLVERS:
        if registry.solvers()[solver].refusal(known.reduction.program):
            continue
        ran += 1
        whole = Fitter(known.declared, solver=solver, request=Request(TOLERANCE, 60.0))
        found = whole.solve()
        assert_law(found, known.solution, solver)
        for part in EARLY:
            request = Request(TOLERANCE, part * max(found.timings.solve, 1e-3))
            stopped = Fitter(known.declared, solver=solver, request=request).solve()
            what = f"{solver}, {part} of its time"
            assert_law(stopped, known.solution, what)
    assert ran > 0
