"""Residuals relative to their summands and limits."""

import numpy as np
import pytest

from tests.problem.verify.test_kkt import program, rows, squares
from tests.solvers import problems
from ttus_opt.problem.members import ProgramBounds
from ttus_opt.problem.program import Program
from ttus_opt.problem.verify.relative_residuals import (
    ROUNDING,
    GradientBlocks,
    _least_gradient,
    largest_of,
    worst_violation,
)


def two_blocks():
    """(3 p₀ − 1)² + (p₀ + q − 2)² over p of one entry and q of one."""
    whole = problems.program([problems.term([[3.0, 0.0], [1.0, 1.0]], [1.0, 2.0])])
    return Program(
        {"p": slice(0, 1), "q": slice(1, 2)}, whole.terms, (), (), whole.laplace
    )


def test_least_gradient_of_squares_is_what_rounding_leaves_of_a_row():
    """2 w ‖row‖ (‖row‖ |x|) ε by block: of p the longest row is 3, of q it is 1."""
    problem = two_blocks()
    for part, longest in ((slice(0, 1), 3.0), (slice(1, 2), 1.0)):
        least = _least_gradient(problem, part, 7.0)
        assert least == pytest.approx(2.0 * longest**2 * 7.0 * ROUNDING)


def test_stray_multipliers_are_an_error_of_their_own():
    blocks = GradientBlocks(two_blocks())
    blocks.add(np.array([3.0, 0.0]))
    blocks.add(np.array([-3.0, 0.0]))
    blocks.add_stray(np.array([0.0, 4.0]))
    assert blocks.error == pytest.approx(4.0)
    assert blocks.worst(0.0) == pytest.approx(1.0)


def test_nan_is_the_largest():
    assert largest_of(1.0, float("nan"), 2.0) == float("inf")
    assert largest_of(1.0, 2.0) == 2.0


def test_a_point_outside_is_measured_by_its_violation():
    problem = program(2, [squares([2, 2])], (rows("sum", [[1, 1]], -np.inf, 2.0),))
    found = worst_violation(problem, np.array([2.0, 2.0]))
    assert found == (2.0, pytest.approx(0.5))
    assert worst_violation(problem, np.array([1.0, 0.5])) == (0.0, 0.0)


def test_the_worst_member_counts_even_if_it_comes_first():
    near, far = rows("near", [[1.0]], -np.inf, 1.9), rows("far", [[1.0]], -np.inf, 1.0)
    for order in ((near, far), (far, near)):
        problem = program(1, [squares([0])], order)
        assert worst_violation(problem, np.array([2.0])) == (1.0, pytest.approx(0.5))


def test_a_member_of_zeros_is_not_judged_by_its_rounding():
    """x₂ ≥ 0 at -1e-16 beside x₁ = 3: its own largest value is that rounding."""
    lower, upper = np.array([-np.inf, 0.0]), np.array([np.inf, 0.0])
    part = ProgramBounds("zero", lower, upper, slice(1, 2))
    problem = program(2, [squares([3.0, 0.0])], (), (part,))
    violation, relative = worst_violation(problem, np.array([3.0, -1e-16]))
    assert violation == 1e-16 and relative < 1e-9
    relative = worst_violation(problem, np.array([3.0, -1e-3]))[1]
    assert relative == pytest.approx(1.0)


def test_rows_that_cancel_everywhere_are_judged_by_what_cancels():
    """x ≤ y with x = y = 3 but for 1e-10: the row's own value is no measure."""
    problem = program(2, [squares([4, 2])], (rows("order", [[1, -1]], -np.inf, 0.0),))
    found = worst_violation(problem, np.array([3.0 + 1e-10, 3.0]))
    assert found == (pytest.approx(1e-10, rel=1e-5), pytest.approx(1e-10 / 3e-3, 1e-5))
