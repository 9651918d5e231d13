"""Working sets with wide terms against eliminated least squares."""

import functools

import numpy as np
import pytest

from tests.solvers.dual.test_subproblem import (
    eliminated,
    random_limits,
    random_working_set,
)
from tests.solvers.dual.user_limits import contested
from tests.solvers.own_terms import AlongZ, DepthWeighted
from ttus_opt.problem.formulation import load
from ttus_opt.solvers.dual.limits import SpokeLimits
from ttus_opt.solvers.dual.solver import Accuracy
from ttus_opt.solvers.dual.working_set import WorkingSet
from ttus_opt.solvers.primal.limited_sum import LimitedSum
from ttus_opt.solvers.primal.split import Split

#: Terms of more rows than these are wide
FEW = 100


@functools.cache
def made(own, hard, prior="eq10"):
    scene = contested(1, (6, 9, 5), n_poses=5)
    declared = load(prior, scene, force_weight=1.0, torque_weight=1.0)
    limits = random_limits(scene, 1, hard)
    program = (declared + own(scene, 3.0)).with_constraints(*limits).compile()
    split = Split.of(program, FEW)
    assert len(split.wide) == 1
    return program, LimitedSum(program, SpokeLimits.of(program), split)


def solved(problem, active, rtol, last=None):
    return problem.subproblem(active).solve(Accuracy(rtol), last).p


@pytest.mark.parametrize("hard", [False, True], ids=["soft", "hard"])
@pytest.mark.parametrize("own", [DepthWeighted, AlongZ], ids=lambda t: t.name)
@pytest.mark.parametrize(
    ("held", "linked"), [(0.1, 0.0), (0.0, 0.3), (0.1, 0.5), (0.6, 0.9)]
)
def test_equals_eliminated_least_squares(held, linked, own, hard):
    program, problem = made(own, hard)
    active = random_working_set(problem.limits, 3, held, linked)
    assert active.count
    expected = eliminated(program, problem.limits, active)
    found = solved(problem, active, 1e-11)
    assert np.linalg.norm(found - expected) <= 1e-7 * np.linalg.norm(expected)
    # the working set holds to rounding: bounds where they are, links at their slope
    bound = np.where(active.bounds > 0, problem.limits.upper, problem.limits.lower)
    at = active.bounds != 0
    np.testing.assert_allclose(found[at], bound[at], atol=1e-12)
    deeper = np.flatnonzero(active.links)
    fall = found[deeper] - found[deeper + problem.limits.stride]
    np.testing.assert_allclose(fall, problem.limits.least[deeper], atol=1e-10)


def test_from_the_last_field_it_takes_fewer_steps_to_the_same():
    program, problem = made(AlongZ, False)
    before = random_working_set(problem.limits, 3, 0.1, 0.3)
    links = before.links.copy()
    links[np.flatnonzero(links)[0]] = False
    after = WorkingSet(before.bounds, links)
    last = eliminated(program, problem.limits, before)
    subproblem = problem.subproblem(after)
    accuracy = Accuracy(1e-6)
    near, far = subproblem.solve(accuracy, last), subproblem.solve(accuracy, None)
    expected = eliminated(program, problem.limits, after)
    assert near.steps < far.steps
    for answer in (near, far):
        apart = np.linalg.norm(answer.p - expected)
        assert apart <= 1e-5 * np.linalg.norm(expected)


def test_out_of_time_it_says_so():
    _, problem = made(AlongZ, False)
    active = random_working_set(problem.limits, 3, 0.1, 0.3)
    answer = problem.subproblem(active).solve(Accuracy(1e-11, deadline=0.0), None)
    assert answer.late


def test_objective_and_gradient_are_the_programs():
    program, problem = made(DepthWeighted, False)
    rng = np.random.default_rng(0)
    p, along = rng.normal(size=(2, len(problem.limits.lower)))
    rests = [(t.weight, t.matrix @ p - t.target) for t in program.terms]
    assert problem.objective(p) == pytest.approx(sum(w * r @ r for w, r in rests))
    slopes = [
        2.0 * w * (t.matrix @ along) @ r
        for t, (w, r) in zip(program.terms, rests, strict=True)
    ]
    assert problem.gradient(p) @ along == pytest.approx(sum(slopes))


def test_soft_boundary_values_stand_alone():
    """Voxels that the Laplace rows leave out, as given values do not exist here."""
    program, problem = made(AlongZ, False)
    np.testing.assert_array_equal(problem.alone, ~program.laplace.free)
    assert problem.shape == program.laplace.grid.shape
