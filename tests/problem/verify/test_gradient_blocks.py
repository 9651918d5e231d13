"""Sizes of gradients by block, by hand."""

import numpy as np
import pytest

from tests.solvers.problems import program, term
from ttus_opt.problem.program import Program
from ttus_opt.problem.verify.gradient_blocks import (
    ROUNDING,
    GradientBlocks,
    _least_gradient,
    largest_of,
    quadratic_summands,
)


def two_blocks():
    """(3 p₀ − 1)² + (p₀ + q − 2)² over p of one entry and q of one."""
    whole = program([term([[3.0, 0.0], [1.0, 1.0]], [1.0, 2.0])])
    return Program(
        {"p": slice(0, 1), "q": slice(1, 2)}, whole.terms, (), (), whole.laplace
    )


def test_summands_add_up_to_the_gradient():
    problem, x = two_blocks(), np.array([0.5, -1.0])
    parts = list(quadratic_summands(problem, x))
    M, t = np.array([[3.0, 0.0], [1.0, 1.0]]), np.array([1.0, 2.0])
    np.testing.assert_allclose(parts[0], 2.0 * M.T @ M @ [0.5, 0.0])
    np.testing.assert_allclose(parts[1], 2.0 * M.T @ M @ [0.0, -1.0])
    np.testing.assert_allclose(parts[2], -2.0 * M.T @ t)
    np.testing.assert_allclose(sum(parts), 2.0 * M.T @ (M @ x - t))


def test_each_block_is_judged_over_its_own_largest_summand():
    blocks = GradientBlocks(two_blocks())
    blocks.add(np.array([1000.0, 2.0]))
    blocks.add(np.array([-1001.0, -1.0]))
    assert blocks.error == pytest.approx(np.sqrt(2.0))
    # p: 1 of 1001; q: 1 of 2 is the worst
    assert blocks.worst(1.0) == pytest.approx(0.5)


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
