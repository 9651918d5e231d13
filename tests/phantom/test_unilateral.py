import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ttus_opt.errors import InputError, TtusError
from ttus_opt.phantom.unilateral import solve_unilateral


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
    assert answer.forces == pytest.approx(brute_force(compliance, depth), abs=1e-8)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 60), flip=st.integers(0, 10**6))
def test_conditions_hold_from_any_start(seed, n, flip):
    compliance, depth = problem(seed, n)
    start = np.random.default_rng(flip).random(n) < 0.5
    answer = solve_unilateral(compliance, depth, start)
    gap = compliance @ answer.forces - depth
    assert (answer.forces >= 0.0).all()
    assert gap.min() >= -1e-9 * np.abs(depth).max()
    assert abs(answer.forces @ gap) <= 1e-8 * (1.0 + answer.forces.sum())


def test_single_pivots_finish_where_blocks_make_no_progress(monkeypatch):
    monkeypatch.setattr("ttus_opt.phantom.unilateral.PATIENCE", 0)
    compliance, depth = problem(5, 40)
    single = solve_unilateral(compliance, depth)
    monkeypatch.undo()
    assert single.forces == pytest.approx(solve_unilateral(compliance, depth).forces)


def test_a_good_guess_needs_one_system():
    compliance, depth = problem(3, 50)
    first = solve_unilateral(compliance, depth)
    assert first.pivots > 1
    assert solve_unilateral(compliance, depth, first.active).pivots == 1


def test_refuses_wrong_shapes_and_indefinite_compliance():
    with pytest.raises(InputError, match=r"\(3, 3\)"):
        solve_unilateral(np.eye(2), np.ones(3))
    with pytest.raises(TtusError, match="positive definite"):
        solve_unilateral(-np.eye(3), np.ones(3))
