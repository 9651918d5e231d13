"""Residuals on problems solved by hand, with the signs of their multipliers."""

import numpy as np
import pytest
import scipy.sparse as sp

from tests.kit import small_scene
from tests.oracles.dense import minimiser, stacked
from ttus_opt.problem.formulation import load
from ttus_opt.problem.members import ProgramBounds, ProgramConstraint, ProgramTerm
from ttus_opt.problem.program import Program
from ttus_opt.problem.terms.penalties import Absolute, Linear
from ttus_opt.problem.verify.distance import CLOSE
from ttus_opt.problem.verify.kkt import Duals, _held, bound_duals, kkt_residuals
from ttus_opt.problem.verify.relative_residuals import _least_gradient

ZERO = np.zeros(1)
LAPLACE = small_scene(shape=(5, 6, 4), n_poses=2).laplace


def program(n, terms, constraints=(), bounds=()):
    return Program({"p": slice(0, n)}, tuple(terms), constraints, bounds, LAPLACE)


def squares(target):
    eye = sp.csr_array(sp.eye_array(len(target)))
    return ProgramTerm("squares", 1.0, eye, np.array(target))


def rows(name, A, low, high):
    m = len(A)
    return ProgramConstraint(
        name, sp.csr_array(np.array(A)), np.full(m, low), np.full(m, high)
    )


def assert_optimal(kkt):
    assert kkt.worst_relative <= 1e-12
    assert max(kkt.primal, kkt.dual, kkt.gap) <= 1e-11


def test_upper_row_has_a_positive_multiplier():
    """min (x-2)² + (y-2)², x + y ≤ 2: x = y = 1, y = 2."""
    problem = program(2, [squares([2, 2])], (rows("sum", [[1, 1]], -np.inf, 2.0),))
    x = np.array([1.0, 1.0])
    assert_optimal(kkt_residuals(problem, x, Duals({"sum": np.array([2.0])})))
    wrong_sign = kkt_residuals(problem, x, Duals({"sum": np.array([-2.0])}))
    assert min(wrong_sign.dual_relative, wrong_sign.gap_relative) >= 0.5


@pytest.mark.parametrize(
    ("target", "row", "low", "high", "x", "y"),
    [
        ([0, 0], [1, 1], 2.0, np.inf, [1.0, 1.0], -2.0),  # a lower limit
        ([0, 0], [1, -1], 2.0, 2.0, [1.0, -1.0], -2.0),  # an equality, either sign
        ([0, 0], [1, -1], -2.0, -2.0, [-1.0, 1.0], 2.0),
    ],
)
def test_lower_rows_and_equalities(target, row, low, high, x, y):
    """min x² + y² under one row: its multiplier by hand."""
    problem = program(2, [squares(target)], (rows("row", [row], low, high),))
    duals = Duals({"row": np.array([y])})
    assert_optimal(kkt_residuals(problem, np.array(x), duals))


def test_a_multiplier_of_an_absent_limit_is_an_error():
    problem = program(1, [squares([0])], (rows("high", [[1.0]], -np.inf, 5.0),))
    kkt = kkt_residuals(problem, np.zeros(1), Duals({"high": np.array([-1.0])}))
    assert kkt.worst_relative >= 1.0


def test_what_is_not_finite_is_infinitely_wrong():
    problem = program(2, [squares([0, 0])])
    kkt = kkt_residuals(problem, np.array([np.nan, 0.0]), Duals())
    assert kkt.worst_relative == np.inf
    assert set(kkt.as_dict()) >= {"primal", "dual", "gap", "gap_relative"}


def test_absolute_penalty_has_a_multiplier_within_one():
    """min ½·2|x| + (x - 0.3)²: x = 0 with g = 0.6; (x - 3)²: x = 2.5 with g = 1."""
    eye = sp.csr_array(sp.eye_array(1))
    for target, solution, g in ((0.3, 0.0, 0.6), (3.0, 2.5, 1.0)):
        terms = [squares([target]), ProgramTerm("size", 1.0, eye, ZERO, Absolute())]
        problem = program(1, terms)
        x = np.array([solution])
        duals = Duals(terms={"size": np.array([g])})
        assert_optimal(kkt_residuals(problem, x, duals))
        # a multiplier outside [-1, 1] is brought back, and then cannot pass
        too_far = Duals(terms={"size": np.array([-5.0])})
        assert kkt_residuals(problem, x, too_far).dual > 0.1
    missing = kkt_residuals(
        program(1, [squares([0.3]), terms[1]]), np.zeros(1), Duals()
    )
    assert missing.dual == pytest.approx(0.6)


def test_bound_duals_go_to_the_bound_that_holds():
    first = ProgramBounds("first", np.array([0.0, -np.inf]), np.array([np.inf, 3.0]))
    second = ProgramBounds("second", np.array([-1.0, -2.0]), np.array([5.0, 1.0]))
    problem = program(2, [squares([0, 0])], (), (first, second))
    split = bound_duals(problem, np.array([-4.0, 2.0]))
    np.testing.assert_array_equal(split["first"], [-4.0, 0.0])
    np.testing.assert_array_equal(split["second"], [0.0, 2.0])
    np.testing.assert_array_equal(split["first"] + split["second"], [-4.0, 2.0])
    assert not bound_duals(problem, None)["first"].any()


def test_equal_bounds_share_no_multiplier():
    both = [ProgramBounds(n, np.zeros(1), np.ones(1)) for n in ("one", "two")]
    problem = program(1, [squares([9.0])], (), (both[0], both[1]))
    split = bound_duals(problem, np.array([16.0]))
    assert (split["one"].item(), split["two"].item()) == (16.0, 0.0)


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["upper", "lower"])
def test_the_gap_alone_can_refuse_an_answer(side):
    """min (x-2)², x ≤ 3 at x = 1.5 with y = 1: r = 0, but the limit is 1.5 away.

    And mirrored: min (x+2)², x ≥ -3 at x = -1.5 with y = -1.
    """
    x, dual = np.array([1.5 * side]), np.array([side])
    low, high = sorted([3.0 * side, -np.inf * side])
    cap, target = rows("cap", [[1.0]], low, high), squares([2.0 * side])
    kkt = kkt_residuals(program(1, [target], (cap,)), x, Duals({"cap": dual}))
    assert (kkt.primal, kkt.dual) == (0.0, 0.0)
    assert kkt.gap == pytest.approx(1.5)
    assert kkt.gap_relative == pytest.approx(1.5 / 0.25)
    assert kkt.worst_relative == kkt.gap_relative
    # of a bound the same
    box = ProgramBounds("box", np.array([low]), np.array([high]))
    kkt = kkt_residuals(program(1, [target], (), (box,)), x, Duals({}, dual))
    assert kkt.gap == pytest.approx(1.5)


def test_rounding_of_rows_that_cancel_is_no_error():
    """(x - y)² at x ≈ y: judged against what rounding leaves of a row."""
    row = sp.csr_array(np.array([[1.0, -1.0]]))
    problem = program(2, [ProgramTerm("difference", 1.0, row, np.zeros(1))])
    off = 1e-9
    kkt = kkt_residuals(problem, np.array([1.0, 1.0 - off]), Duals())
    assert kkt.dual == pytest.approx(2.0 * np.sqrt(2.0) * off, rel=1e-6)
    assert kkt.dual_relative == pytest.approx(kkt.dual / 4e-6, rel=1e-6)


def test_every_block_is_judged_by_its_own_summands():
    """A small parameter beside a large field: its wrong value is no rounding."""
    members = (
        ProgramTerm(name, 1.0, sp.csr_array(np.array([row])), np.array([target]))
        for name, row, target in (
            ("field", [1e6, 0.0], 1e6),
            ("parameter", [0.0, 1e-3], 1e-3),
        )
    )
    both = {"p": slice(0, 1), "c": slice(1, 2)}
    problem = Program(both, tuple(members), (), (), LAPLACE)
    assert_optimal(kkt_residuals(problem, np.array([1.0, 1.0]), Duals()))
    wrong = kkt_residuals(problem, np.array([1.0, 0.5]), Duals())
    assert wrong.dual_relative == pytest.approx(0.5)


def test_a_bound_far_above_what_is_asked_comes_close():
    """Along what measured rows hold: the prior alone bounds it a hundredfold."""
    scene = small_scene(shape=(7, 12, 7), n_poses=2)
    declared = load("eq10", scene, force_weight=100.0, torque_weight=100.0)
    problem = declared.compile()
    M, best = stacked(problem)[0], minimiser(problem)
    laplace = scene.laplace
    along = laplace.solve(laplace.solve_adjoint(scene.N.T @ np.ones(scene.N.shape[0])))
    along *= 1e-2 / np.linalg.norm(M @ along)
    kkt = kkt_residuals(problem, best + along, Duals(), tolerance=1e-9)
    assert 1.0 <= kkt.gap / 1e-4 <= 1.0 + 1.1 * CLOSE


def test_an_objective_that_vanishes_is_judged_by_the_distance():
    problem = program(1, [squares([4.0])])
    for off in (1e-9, 1e-6):
        kkt = kkt_residuals(problem, np.array([4.0 + off]), Duals())
        assert kkt.gap_relative == pytest.approx(100.0 * off / 4.0, rel=0.1)
        assert kkt.distance == pytest.approx(off, rel=0.1)
        assert kkt.primal == kkt.primal_relative == 0.0  # without any limit


def test_what_equalities_hold_counts_by_how_far_it_is_off():
    """2 x₁ = 3 at x₁ = 2 is off by half in x₁; the sum of both fixes neither."""
    held, both = rows("held", [[2.0, 0.0]], 3.0, 3.0), rows("both", [[1, 1]], 0.0, 0.0)
    x, r = np.array([2.0, 7.0]), np.array([-6.0, 5.0])
    assert _held(held, x, r) == 3.0
    assert _held(both, x, r) == 0.0


def test_a_linear_term_hides_no_other_from_the_least_gradient():
    eye = sp.csr_array(sp.eye_array(2))
    linear = ProgramTerm("linear", 5.0, eye, np.zeros(2), Linear())
    absolute = ProgramTerm("absolute", 3.0, eye, np.zeros(2), Absolute())
    for terms in ([linear, absolute], [absolute, linear]):
        assert _least_gradient(program(2, terms), slice(0, 2), 1.0) == 3.0
