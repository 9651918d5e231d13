import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.refusals import refuses
from ttus_opt.core.errors import InputError
from ttus_opt.phantom.press import solve_unilateral


def problem(seed, n):
    """A random compliance, definite, and depths of both signs."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n))
    return root @ root.T + 0.1 * np.eye(n), rng.normal(size=n)


def brute_force(compliance, depth):
    """Try every set of touching nodes."""
    n = len(depth)
    for size in range(n + 1):
        for nodes in itertools.combinations(range(n), size):
            index = list(nodes)
            forces = np.zeros(n)
            if index:
                block = compliance[np.ix_(index, index)]
                forces[index] = np.linalg.solve(block, depth[index])
            gap = compliance @ forces - depth
            if (forces >= -1e-10).all() and (gap >= -1e-10).all():
                return forces
    raise AssertionError("no answer")


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 7))
def test_equals_brute_force(seed, n):
    compliance, depth = problem(seed, n)
    answer = solve_unilateral(compliance, depth)
    assert answer == pytest.approx(brute_force(compliance, depth), abs=1e-8)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 60))
def test_conditions_hold(seed, n):
    compliance, depth = problem(seed, n)
    answer = solve_unilateral(compliance, depth)
    gap = compliance @ answer - depth
    assert (answer >= 0.0).all()
    assert gap.min() >= -1e-9 * np.abs(depth).max()
    assert abs(answer @ gap) <= 1e-8 * (1.0 + answer.sum())


def test_refuses_wrong_shapes_and_indefinite_compliance():
    refuses(InputError, r"\(3, 3\)", solve_unilateral, np.eye(2), np.ones(3))
    refuses(InputError, "positive definite", solve_unilateral, -np.eye(3), np.ones(3))
